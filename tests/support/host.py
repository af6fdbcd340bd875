"""A host process: ``python -m tests.support.host URL`` leases the rig and plays one long tone."""

import sys

from drivers.controller import Tone
from drivers.errors import ControllerError
from drivers.url import connect


def main(url: str, seconds: float = 60.0) -> int:
    controller = connect(url)
    rate = controller.capabilities().sample_rate_hz
    tone = Tone(axis=0, amplitude_a=0.05, periods=20, samples=round(rate), blocks=max(round(seconds), 1))
    try:
        with controller.lease("victim", seconds=2.0):
            print("leased", flush=True)
            controller.measure(tone)
    except ControllerError as error:
        print(error, flush=True)
        return 1
    finally:
        controller.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1], *(float(a) for a in sys.argv[2:])))
