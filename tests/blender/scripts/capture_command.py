"""Captures the tiny character through the command, as a farm does. Arguments: those of ``chona capture``."""

from __future__ import annotations

import sys

import tiny_character

import chona_blender
from chona_blender import commands

chona_blender.register()
tiny_character.build()
sys.exit(commands.main(["capture", *tiny_character.OPTIONS, "--progress", "json", *sys.argv[1:]]))
