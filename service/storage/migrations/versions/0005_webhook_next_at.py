"""when a webhook is told again: messages that wait do so in their rows, and are due at once"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    table = "webhook_deliveries"
    op.add_column(table, sa.Column("next_at", sa.DateTime(timezone=True), nullable=True))
    op.drop_index("ix_webhook_deliveries_dispatched", table)
    op.create_index("ix_webhook_deliveries_next_at", table, ["next_at"])
    deliveries = sa.table(table, *map(sa.column, ("state", "next_at", "dispatched", "updated_at")))
    waiting = deliveries.update().where(deliveries.c.state == "pending")
    op.execute(waiting.values(next_at=deliveries.c.updated_at, dispatched=sa.false()))
