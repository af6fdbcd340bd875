"""A page in a real browser without a network: what it drew, and what it complained about."""

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

BROWSER = next(filter(None, (shutil.which(n) for n in ("chromium", "chromium-browser", "google-chrome"))), None)

QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
"""A browser without a window, and without a word to anybody of its own accord."""
OPTIONS = (
    *QUIET,
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--enable-logging=stderr",
    "--virtual-time-budget=30000",
    "--window-size=1200,2000",
)


@dataclass(frozen=True)
class Opened:
    """A page after its scripts ran."""

    dom: str
    complaints: tuple[str, ...]
    """Errors and warnings of the console."""

    def drawn(self, name: str) -> int:
        """How many panels of a figure have an axis drawn."""
        place = self.dom.find(f'id="{name}"')
        end = self.dom.find("</figure>", place)
        return len(re.findall(r'class="[^"]*\bcartesianlayer\b', self.dom[place:end])) if place >= 0 else 0


def opened(page: Path) -> Opened:
    """Load a page and wait until it is drawn."""
    assert BROWSER is not None
    with tempfile.TemporaryDirectory() as profile:
        done = subprocess.run(
            [BROWSER, *OPTIONS, f"--user-data-dir={profile}", "--dump-dom", page.as_uri()],
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
            env={**os.environ, "TMPDIR": profile},
        )
    return Opened(done.stdout, tuple(x for x in done.stderr.splitlines() if ":CONSOLE" in x))
