"""What the processes of a diagnosis wait for before they can fit anything."""

import subprocess
import sys

from service.gap.processes import LOADED


def test_no_fit_waits_for_what_only_some_diagnoses_need():
    load = f"import sys, {', '.join(LOADED)}, service.gap.diagnose; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", load], check=True, capture_output=True, text=True).stdout.split()
    assert "service.gap.fitting.fit" in loaded
    assert not {"scipy.optimize", "scipy.ndimage", "service.gap.next_experiment", "service.campaign"} & {*loaded}
