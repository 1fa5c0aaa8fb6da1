"""Raw frames to BRDF samples; the folder installs as `gonio.calibration`."""

# One file must never be two modules (docs/adr/0001-one-import-name.md).
if __name__ != "gonio.calibration":
    raise ImportError(
        f"this folder is the package gonio.calibration and was imported as {__name__!r}: "
        "install the project and import gonio.calibration."
    )
