from gonio import materials

print(len(materials.names()), "materials, among them", materials.names()[:3])
brass = materials.get("rolled_brass")
print(brass.model, dict(brass.parameters))
