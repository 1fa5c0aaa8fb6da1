from gonio.instrument import preset

rig = preset("modern12")
print(f"{rig.dome.shape}, R = {rig.dome.R:g} mm, D = {rig.dome.D:g} mm")
print("half-angle of the lamp's cone:", rig.lamp.half_angle_deg, "deg")
