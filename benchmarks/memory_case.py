"""One case of ``benchmarks.memory`` in a process of its own: prints the covered share and the peak in GiB."""

from __future__ import annotations

import resource
import sys

from chona_model.process import tune

tune()  # before torch is imported

from benchmarks import memory  # noqa: E402
from benchmarks.common import Bench, parser  # noqa: E402


def main() -> int:
    """Runs the case."""
    options = parser()
    options.add_argument("case")
    chosen = options.parse_args()
    bench = Bench.of(chosen)
    covered = 0.0
    if chosen.case == "training":
        memory.training(bench)
    else:
        covered = memory.frame(bench, chosen.case)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    sys.stdout.write(f"{covered:.3f} {peak:.3f}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
