from importlib.resources import as_file, files

from gonio.rig import import_frames

with as_file(files("gonio.data") / "demo_rig") as folder:
    imported = import_frames(folder, "rig.gonio")
print(imported.session.n_done, "frames;", len(imported.warnings), "warnings")
