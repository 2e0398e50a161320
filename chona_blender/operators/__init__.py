"""Operators: each gathers, calls and reports; what they do lies in the modules above."""
