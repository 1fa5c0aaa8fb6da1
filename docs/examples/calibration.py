from math import radians

from gonio.calibration.reflector import camera_angles, reflected_angles, solid_angle_ratio

# Eq. (3) of Ward 1992: where the camera looks, and the direction in which the sample reflected.
theta_r, phi_r = reflected_angles(radians(30), 0.0, R=150.0, D=15.0)
theta_c, phi_c = camera_angles(theta_r, phi_r, R=150.0, D=15.0)
print(f"theta_r = {theta_r:.5f}, back at the camera {theta_c:.5f}")
print(f"solid angle of a pixel: times {solid_angle_ratio(radians(30), 0.0, R=150.0, D=15.0):.4f}")
