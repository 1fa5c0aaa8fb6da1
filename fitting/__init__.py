"""BRDF samples to model parameters; the folder installs as `gonio.fitting`."""

# One file must never be two modules (docs/adr/0001-one-import-name.md).
if __name__ != "gonio.fitting":
    raise ImportError(
        f"this folder is the package gonio.fitting and was imported as {__name__!r}: "
        "install the project and import gonio.fitting."
    )
