"""Measures speed and what it costs; writes ``benchmarks/results/*.json`` and plots.

python -m benchmarks frames training --data D --format behave --train A,B --test C --model RUN/model.safetensors
"""

from __future__ import annotations

import importlib

from chona_model.process import tune

tune()  # before torch is imported

from benchmarks.common import Bench, parser  # noqa: E402

SUBJECTS = (
    "training",
    "frames",
    "growth",
    "memory",
    "startup",
    "exact",
    "distilled",
    "recovery",
    "numerics",
    "estimate",
    "blur",
    "farm",
)
WITHOUT_DATA = {"recovery", "numerics"}
"""Subjects that need no capture; ``recovery`` also measures the poses of one that is there."""


def main() -> int:
    """Runs the chosen subjects, by default all."""
    options = parser()
    options.add_argument("subjects", nargs="*", metavar="SUBJECT", help=", ".join(SUBJECTS))
    chosen = options.parse_args()
    unknown = sorted(set(chosen.subjects) - set(SUBJECTS))
    if unknown:
        options.error(f"'{unknown[0]}' is no subject; there are {', '.join(SUBJECTS)}")
    bench = Bench.of(chosen)
    if not bench.data.is_dir() and not set(chosen.subjects or SUBJECTS) <= WITHOUT_DATA:
        options.error(f"there is no capture {bench.data}; 'make demo' makes one, or name yours with --data")
    for subject in chosen.subjects or SUBJECTS:
        importlib.import_module(f"benchmarks.{subject}").measure(bench)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
