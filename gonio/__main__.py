"""`python -m gonio` is the command `gonio`."""

from __future__ import annotations

from gonio.cli import main

if __name__ == "__main__":
    main()
