from importlib.resources import as_file, files

from gonio.rig import import_rig

with as_file(files("gonio.data") / "demo_rig") as folder:
    imported = import_rig(folder, "rig.gonio")
print(imported.session.n_done, "frames;", len(imported.warnings), "warnings")
