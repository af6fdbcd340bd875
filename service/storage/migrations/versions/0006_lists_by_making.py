"""results in the order in which they were made: a page of a long list took the whole table"""

from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table in ("experiments", "models", "gaps", "health_checks"):
        op.create_index(f"ix_{table}_created_at_id", table, ["created_at", "id"])
        op.create_index(f"ix_{table}_rig_id_created_at_id", table, ["rig_id", "created_at", "id"])
        op.drop_index(f"ix_{table}_rig_id", table)
