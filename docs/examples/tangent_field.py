import numpy as np

from gonio.geometry import unit_vectors
from gonio.tangent_field import FieldPrior, Nodes

# Directions of a dome are off by 0.06 deg at the zenith and more at the rim, alike over 10 deg.
prior = FieldPrior(zenith=np.radians(0.06), rim=np.radians(0.4), correlation=np.radians(10))
nodes = Nodes.on_cap(prior, theta_max=np.radians(80), most=1000)
w = unit_vectors(np.radians([0.0, 80.0]), np.zeros(2))
print(len(nodes), "nodes; sd", np.degrees(prior.sd(w)).round(3), "deg")
