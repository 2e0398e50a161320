"""The demo: a small character and a crate, captured, learned and animated anew. Start it with ``demo/run.py``."""
