"""What CHONA's speed is measured with; `python -m benchmarks --help`."""
