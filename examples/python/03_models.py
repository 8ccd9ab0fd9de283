"""Example 3: one planned blow, predicted by all three models on soft wood."""

import mrr

robot = mrr.load_robot("mrr3")
wood = mrr.ContactLaw()
wood.nail_resistance_n = 40.0
wood.nail_resistance_slope_n_m = 400.0
wood.nail_room_m = 0.04
blow = mrr.plan(robot).predict_input(wood)
for model in ("instant", "finite_time", "resolved"):
    p = mrr.predict(robot, blow, model)
    print(f"{model:12} {p.impulse_n_s:5.2f} N s in {1e3 * p.contact_s:5.1f} ms; joints carry {p.axis_impulse_nm_s.round(2)} N m s")
