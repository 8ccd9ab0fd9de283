"""Example 4: where in its workspace an arm strikes hardest: effective mass over the plane of base and nail."""

import mrr
import numpy as np

robot = mrr.load_robot("mrr3")
for measure in mrr.measures:
    print(f"{measure['name']:22} {measure['unit']:12} {measure['meaning']}")
field = mrr.measure_map(robot, "effective_mass", columns=24, rows=16)
values = np.where(np.isfinite(field.values), field.values, np.nan)
row, column = np.unravel_index(np.nanargmax(values), values.shape)
print(f"heaviest: {values[row, column]:.1f} kg, {field.along_m[column]:.2f} m along and {field.up_m[row]:.2f} m up")
