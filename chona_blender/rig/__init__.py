"""From rigs in a scene to the rigid bone frames that a model is posed with."""
