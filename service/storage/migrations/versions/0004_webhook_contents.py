"""what a webhook is told, and whether the job engine knows of it"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    document = sa.JSON().with_variant(JSONB(), "postgresql")
    table = "webhook_deliveries"
    op.add_column(table, sa.Column("contents", document, nullable=False, server_default="{}"))
    op.add_column(table, sa.Column("dispatched", sa.Boolean(), nullable=False, server_default=sa.true()))
    op.create_index("ix_webhook_deliveries_dispatched", table, ["dispatched"])
