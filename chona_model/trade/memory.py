"""Peak memory of a piece of work, where the system lets it be asked."""

from __future__ import annotations

import contextlib
from pathlib import Path

import torch

_CLEAR, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")


class PeakMemory:
    """Highest memory of the process since it was made, megabytes.

    On Linux the process's resident memory, of a CUDA device what its tensors took; elsewhere unknown, None.
    """

    def __init__(self, device: str = "cpu") -> None:
        self._cuda = device if device.startswith("cuda") else None
        self._known = self._cuda is not None
        if self._cuda:
            torch.cuda.reset_peak_memory_stats(self._cuda)
        else:
            with contextlib.suppress(OSError):
                _CLEAR.write_text("5")  # proc(5): resets the peak resident set size
                self._known = _STATUS.is_file()

    def megabytes(self) -> float | None:
        """The peak so far."""
        if not self._known:
            return None
        if self._cuda:
            return torch.cuda.max_memory_allocated(self._cuda) / 1e6
        line = next(line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
