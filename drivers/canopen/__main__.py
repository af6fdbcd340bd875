"""``python -m drivers.canopen docs/amb.eds``: the EDS file of a controller."""

import sys
from pathlib import Path

from drivers.canopen.map import eds

if __name__ == "__main__":
    Path(sys.argv[1]).write_text(eds(), encoding="utf-8")
