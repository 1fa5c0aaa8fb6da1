"""A lab's own frames: a folder of pictures with one session.toml becomes a session.

`session.toml` says what the rig is and which file is which frame (`tables`); the pictures are read
as raw counts (`pictures`), and nothing is subtracted, scaled or repaired on the way.
"""

from gonio.rig.importing import Imported, check_frames, import_rig
from gonio.rig.session_file import RigFile, read

__all__ = ["Imported", "RigFile", "check_frames", "import_rig", "read"]
