"""What can go wrong while training."""


class TrainingError(ValueError):
    """Training that cannot go on: the message says at which step, why, and what to do."""
