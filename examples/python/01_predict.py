"""Example 1: what a blow does to every joint. The reference arm, stretched out, swings its shoulder against a rigid board;
once with the hammer joints free, once with the shoulder held."""

import mrr

robot = mrr.load_robot("mrr3")
for shoulder in ("passive", "held"):
    blow = mrr.predict(robot, q=[0, 0, 0], qd=[0, -0.62, 0], joints=["passive", shoulder, "passive"], model="instant")
    print(f"shoulder {shoulder:8} impulse {blow.impulse_n_s:.2f} N s, joints carry {abs(blow.blow_impulse_nm_s).round(3)} N m s")
