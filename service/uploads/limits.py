"""What an uploaded file may cost."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Bounds of one upload. The whole of a 20 min campaign, demodulated, is below 10 MiB, and is read in 0.1 s."""

    file_bytes: int = 256 * MIB
    """The file as sent."""
    decoded_bytes: int = 512 * MIB
    """All its arrays, unpacked."""
    memory_bytes: int = 2048 * MIB
    """Address space of the reading process beyond what its libraries take."""
    check_cpu_s: float = 0.8
    """Processor time to look at the structure, before anything is read."""
    read_cpu_s: float = 0.6
    """Processor time to read a small file."""
    decoded_bytes_per_s: float = 60 * MIB
    """A larger file gets a second more for each of these; records are read at 140 MiB/s on a common laptop."""
    wall_s: float = 20.0
    """As above, on the wall clock of a busy machine."""
    objects: int = 20_000
    """Groups, datasets, attributes, references, each."""
    depth: int = 8
    """Groups in groups; the contract needs 2, MATLAB 3."""
    points: int = 20_000
    """Of one sweep; a long campaign has 2,000."""
    attribute_bytes: int = MIB
    """One attribute."""
    ratio: float = 300.0
    """Of unpacked to packed, where there is much to unpack. Measured data reach 2 to 20."""
    ratio_from_bytes: int = 16 * MIB
    """A few constant arrays pack better than any ratio: below this nobody asks."""

    def read_seconds(self, decoded_bytes: int) -> float:
        """Processor time to read a file that unpacks to so much."""
        return self.read_cpu_s + decoded_bytes / self.decoded_bytes_per_s
