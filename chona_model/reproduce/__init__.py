"""The paper's tables, made again: every cell trained and measured here, beside the paper's figures."""
