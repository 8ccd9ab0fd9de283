"""Example 2: plan a blow on the task's nail, say why so, and look at the swing."""

import mrr
import numpy as np

robot = mrr.load_robot("mrr3")
plan = mrr.plan(robot)
print(plan)
times = np.linspace(0.0, plan.strike_duration_s, 200)
q, qd, qdd = plan.strike(times)
print(f"fastest joint: {abs(qd).max():.3f} rad/s; at contact {plan.contact_time_s:.3f} s after the start")
