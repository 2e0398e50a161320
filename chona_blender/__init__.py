"""CHONA in Blender: posed armatures and empties become frames of learned people handling objects, composited by depth.

In Blender's process there is only bpy and numpy; the neural work is done by `chona_model` in a worker process.
"""

from __future__ import annotations

import sys
import traceback


def register() -> None:
    """Switch the add-on on. Where that fails, a panel with the reason, to be read and copied, stands in for it."""
    try:
        from . import registration

        registration.register()
    except Exception:
        from . import failure

        failure.register(traceback.format_exc())


def unregister() -> None:
    """Switch off whatever `register` switched on."""
    from . import failure

    if failure.is_registered():
        failure.unregister()
        for name in [each for each in sys.modules if each.startswith(f"{__package__}.")]:
            del sys.modules[name]  # what is mended or installed again is read anew when it is switched on
            globals().pop(name.removeprefix(f"{__package__}."), None)
        return
    from . import registration

    registration.unregister()
