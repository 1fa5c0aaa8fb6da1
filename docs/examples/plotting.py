from gonio import plotting

axes = plotting.model_lobes("ward", {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2})
plotting.save(axes[0].figure, "lobe.pdf", size=(5, 4))
print(axes[0].get_title())
