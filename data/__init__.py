"""Printed tables, presets and small files that gonio ships; it installs as `gonio.data`."""

if __name__ != "gonio.data":
    raise ImportError(
        f"this folder is the package gonio.data and was imported as {__name__!r}; "
        "install gonio and import gonio.data."
    )
