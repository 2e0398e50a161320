"""The one exception for everything a user can put right."""

from __future__ import annotations


class ChonaError(Exception):
    """A message for the user: what was given, what was expected, what to do.

    Operators report its text; scripts may catch it.  Anything else that is raised is a fault of the add-on.
    """
