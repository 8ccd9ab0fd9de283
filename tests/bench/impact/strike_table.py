#!/usr/bin/env python3
"""Tables and picture of docs/impulse_prediction.md from the CSV of strike_campaign.

    strike_table.py CSV... [--picture FILE.svg] [--models NAME,...] [--twin CSV]

--twin: the same strikes emulated with other robots of the same description (strike_campaign --world 1), as one more model:
what somebody knows who knows everything but this very robot.

The error of a prediction is relative to the larger of the true value and a floor: a share of what the joint's rated
torque amounts to (impulse: times the contact time). Without a floor a joint that carries nothing would count as wrong
by any percentage.
"""
import argparse
import csv
import math

FLOOR = 0.25  # of the rated torque
MODELS = "printed free assumed free_law instant finite resolved several".split()


def load(paths):
    rows = []
    for path in paths:
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                rows.append({k: v if k in ("board", "robot") else float(v) for k, v in row.items()})
    return rows


def add_twins(rows, path):
    """Gives each row what happened to another robot; rows without one are left out."""
    others = {(r["robot"], r["strike"], r["joint"]): r for r in load([path])}
    kept = []
    for row in rows:
        other = others.get((row["robot"], row["strike"], row["joint"]))
        if other is None:
            continue
        row["twin_P"], row["twin_t"], row["twin_before"] = other["impulse"], other["contact_s"], other["true_before"]
        row["twin_impulse"], row["twin_peak"] = other["true_impulse"], other["true_peak"]
        row["twin_blow"] = other["true_impulse"] - other["weight"] * other["contact_s"]
        kept.append(row)
    return kept


def quantile(values, share):
    values = sorted(values)
    if not values:
        return math.nan
    x = share * (len(values) - 1)
    low = int(x)
    high = min(low + 1, len(values) - 1)
    return values[low] + (x - low) * (values[high] - values[low])


def error(row, model, what):
    """Relative error of a joint's impulse (all of it), of the blow's part of it, or of its peak torque."""
    rated = row["rated"]
    if what == "peak":
        return abs(row[f"{model}_peak"] - row["true_peak"]) / max(row["true_peak"], FLOOR * rated)
    true = row["true_impulse"]
    if what == "blow":
        true -= row["weight"] * row["contact_s"]
    return abs(row[f"{model}_{what}"] - true) / max(abs(true), FLOOR * rated * row["contact_s"])


def blow_error(row, model):
    return abs(row[f"{model}_P"] - row["impulse"]) / row["impulse"]


def cell(values):
    return f"{100 * quantile(values, .5):.0f} / {100 * quantile(values, .95):.0f}" if values else "-"


def table(rows, models):
    yield "| joints | | " + " | ".join(models) + " |"
    yield "| --- | --- |" + " --- |" * len(models)
    # A joint that no blow ever turns or loads (the base of a planar arm) says nothing of a prediction.
    moved = {r["joint"] for r in rows if abs(r["lever"]) > 0.02}
    blows = {(r["robot"], r["strike"]): r for r in rows}.values()
    joints = sorted(int(j) for j in moved)
    rows = [r for r in rows if r["joint"] in moved]
    groups = [("all", rows)]
    for board in ("hardwood", "styrofoam"):
        for passive in (0, 1):
            groups.append((f"{board}, {'passive' if passive else 'active'}",
                           [r for r in rows if r["board"] == board and r["passive"] == passive]))
    for joint in joints:
        for passive in (0, 1):
            groups.append((f"joint {joint}, {'passive' if passive else 'active'}",
                           [r for r in rows if r["joint"] == joint and r["passive"] == passive]))
    for what in ("impulse", "blow", "peak"):
        for name, group in groups:
            cells = [cell([error(r, m, what) for r in group]) for m in models]
            yield f"| {name} ({len(group)}) | {what} | " + " | ".join(cells) + " |"
    for board in ("hardwood", "styrofoam"):
        group = [r for r in blows if r["board"] == board]
        yield f"| {board} ({len(group)}) | on the nail | " + " | ".join(
            cell([blow_error(r, m) for r in group]) for m in models) + " |"


def classes(rows, model):
    """What the errors of one model are made of."""
    moved = {(r["robot"], r["joint"]) for r in rows if abs(r["lever"]) > 0.02}
    rows = [r for r in rows if (r["robot"], r["joint"]) in moved]
    ended = lambda r: abs(r[f"{model}_t"] - r["contact_s"]) <= 0.2 * r["contact_s"]
    off = lambda r: abs(r[f"{model}_before"] - r["true_before"]) > 0.1 * r["rated"]
    groups = [
        ("all", lambda r: True),
        ("no joint passive", lambda r: r["mask"] == 0),
        ("some joint passive", lambda r: r["mask"] != 0),
        ("speed below 0.3 of the limit", lambda r: r["speed_share"] < 0.3),
        ("speed at least 0.3 of the limit", lambda r: r["speed_share"] >= 0.3),
        ("contact time predicted within 20 %", ended),
        ("contact longer than predicted by more", lambda r: not ended(r) and r["contact_s"] > r[f"{model}_t"]),
        ("contact shorter than predicted by more", lambda r: not ended(r) and r["contact_s"] < r[f"{model}_t"]),
        ("ended as predicted, torque at first touch within 10 % of rated", lambda r: ended(r) and not off(r)),
        ("ended as predicted, torque at first touch further off", lambda r: ended(r) and off(r)),
        ("true value below the floor (impulse)",
         lambda r: abs(r["true_impulse"]) < FLOOR * r["rated"] * r["contact_s"]),
    ]
    if any(r[f"{model}_low"] < r[f"{model}_high"] for r in rows):
        yield from covered(rows, model)
        yield ""
    worst = sorted(rows, key=lambda r: -error(r, model, "impulse"))[:len(rows) // 20]
    yield f"| strikes, {model} | impulse | blow | peak | share of the worst 5 % (impulse) |"
    yield "| --- | --- | --- | --- | --- |"
    for name, test in groups:
        group = [r for r in rows if test(r)]
        cells = [cell([error(r, model, what) for r in group]) for what in ("impulse", "blow", "peak")]
        share = sum(map(test, worst)) / max(len(worst), 1)
        yield f"| {name} ({len(group)}) | " + " | ".join(cells) + f" | {share:.0%} |"


def covered(rows, model):
    """How often the truth is between a model's smallest and largest."""
    for what, low, high in (("impulse", f"{model}_low", f"{model}_high"), ("peak", f"{model}_peak_low", f"{model}_peak_high")):
        floor = {"impulse": lambda r: FLOOR * r["rated"] * r["contact_s"], "peak": lambda r: FLOOR * r["rated"]}[what]
        true = [r[f"true_{what}"] for r in rows]
        inside = sum(r[low] <= t <= r[high] for r, t in zip(rows, true)) / len(rows)
        width = cell([(r[high] - r[low]) / max(abs(t), floor(r)) for r, t in zip(rows, true)])
        yield f"{model}, {what}: {inside:.0%} of the true values within the range; its width {width} %"


def choices(rows, models):
    """What each model's choice of passive joints costs in truth: rows of strike_campaign --every-selection."""
    strikes = {}
    for r in rows:
        blow = strikes.setdefault((r["robot"], r["strike"]), {}).setdefault(r["mask"], {"true": 0.0})
        blow["true"] = max(blow["true"], r["true_peak"] / r["rated"] / r["impulse"])
        for m in models:
            load = r[f"{m}_peak"] if m in ("finite", "resolved", "several") else abs(r[f"{m}_blow"])
            P = r[f"{m}_P"]
            blow[m] = max(blow.get(m, 0.0), load / r["rated"] / P if P > 0 else math.inf)
    strikes = [s for s in strikes.values() if len(s) > 1]
    yield f"| {len(strikes)} strikes, chosen by | the truly best | load over the best, median / 95th | largest |"
    yield "| --- | --- | --- | --- |"
    for m in ["nobody: no joint passive", "nobody: all passive", *models]:
        costs = []
        for s in strikes:
            best = min(blow["true"] for blow in s.values())
            if m == "nobody: no joint passive":
                mask = min(s)
            elif m == "nobody: all passive":
                mask = max(s)
            else:
                mask = min(s, key=lambda k: (s[k][m], k))
            costs.append(s[mask]["true"] / best)
        right = sum(c < 1.02 for c in costs) / len(costs)
        yield f"| {m} | {right:.0%} | {quantile(costs, .5):.2f} / {quantile(costs, .95):.2f} | {max(costs):.1f} |"


def picture(rows, models, path):
    """Cumulative distributions of the errors as SVG."""
    width, height, left, top = 360, 260, 50, 24
    colours = ["#999", "#c60", "#e90", "#7a7", "#09c", "#639", "#000", "#c06", "#0a0"]
    parts = []
    for k, what in enumerate(("impulse", "peak")):
        x0 = left + k * (width + 70)
        parts.append(f'<text x="{x0}" y="{top - 8}">error of {"axis impulse" if what == "impulse" else "peak torque"}, %</text>')
        parts.append(f'<rect x="{x0}" y="{top}" width="{width}" height="{height}" fill="none" stroke="#888"/>')
        for tick in (1, 3, 10, 30, 100):
            x = x0 + width * math.log10(tick / 1) / math.log10(200)
            parts.append(f'<line x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{top + height}" stroke="#ddd"/>'
                         f'<text x="{x - 8:.1f}" y="{top + height + 16}">{tick}</text>')
        for share in (0.5, 0.95):
            y = top + height * (1 - share)
            parts.append(f'<line x1="{x0}" y1="{y:.1f}" x2="{x0 + width}" y2="{y:.1f}" stroke="#ddd"/>'
                         f'<text x="{x0 - 34}" y="{y + 4:.1f}">{100 * share:.0f} %</text>')
        for m, model in enumerate(models):
            errors = sorted(error(r, model, what) for r in rows if abs(r["lever"]) > 0.02)
            points = []
            for i, e in enumerate(errors):
                x = min(max(100 * e, 1), 200)
                points.append(f"{x0 + width * math.log10(x) / math.log10(200):.1f},"
                              f"{top + height * (1 - (i + 1) / len(errors)):.1f}")
            parts.append(f'<polyline points="{" ".join(points[::max(1, len(points) // 200)])}" fill="none" '
                         f'stroke="{colours[m % len(colours)]}" stroke-width="1.6"/>')
    for m, model in enumerate(models):
        y = top + height + 38
        x = left + 92 * m
        parts.append(f'<line x1="{x}" y1="{y - 4}" x2="{x + 18}" y2="{y - 4}" stroke="{colours[m % len(colours)]}" '
                     f'stroke-width="2"/><text x="{x + 22}" y="{y}">{model}</text>')
    with open(path, "w") as file:
        file.write(f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * width + 140}" height="{height + 80}" '
                   'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
                   + "".join(parts) + "</svg>\n")


def main():
    global FLOOR
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", nargs="+")
    parser.add_argument("--picture")
    parser.add_argument("--choices", action="store_true", help="what each model's choice of passive joints costs")
    parser.add_argument("--twin", help="CSV of the same strikes with other robots")
    parser.add_argument("--floor", type=float, default=FLOOR, help="share of the rated torque (default %(default)s)")
    parser.add_argument("--models", default=",".join(MODELS))
    options = parser.parse_args()
    FLOOR = options.floor
    models = options.models.split(",")
    rows = load(options.csv)
    if options.twin:
        rows = add_twins(rows, options.twin)
        models.append("twin")
    print(f"Median / 95th percentile of |error|, %. Floor {FLOOR:.0%} of rated.\n")
    if options.choices:
        print("\n".join(choices(rows, models)))
        return
    print("\n".join(table(rows, models)))
    for model in [m for m in models if m in ("resolved", "several")]:
        print()
        print("\n".join(classes(rows, model)))
    if options.picture:
        picture(rows, models, options.picture)


if __name__ == "__main__":
    main()
