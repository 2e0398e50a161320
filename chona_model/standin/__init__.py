"""Stand-ins: meshes of a model's people and objects, for the viewport, for shadows and for reflections."""
