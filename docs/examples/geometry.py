from gonio.geometry import Directions

pair = Directions(theta_i=0.5, phi_i=0.0, theta_r=[0.2, 0.4], phi_r=3.1)
w_i, w_r = pair.vectors()
print("cosine of theta_r:", w_r[:, 2].round(4))
print("theta_i when light and viewer are swapped:", pair.swapped().theta_i)
