"""``python -m drivers.canopen docs/amb.eds [map.toml]``: the EDS file of a controller, or of one with its own map."""

import sys
from pathlib import Path

from drivers.canopen.dictionary import eds
from drivers.canopen.map import DEFAULT_MAP, read_map

if __name__ == "__main__":
    objects = read_map(Path(sys.argv[2])) if len(sys.argv) > 2 else DEFAULT_MAP
    Path(sys.argv[1]).write_text(eds(objects=objects), encoding="utf-8")
