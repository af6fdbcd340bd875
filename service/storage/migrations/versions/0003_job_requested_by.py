"""who had a job's run done, by key and name"""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("requested_by", sa.String(length=200), nullable=False, server_default=""))
    op.add_column("jobs", sa.Column("requested_key", sa.String(length=40), nullable=False, server_default=""))
    op.execute("UPDATE jobs SET requested_by = submitted_by")
