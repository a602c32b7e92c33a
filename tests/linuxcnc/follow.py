#!/usr/bin/python3
"""Compares what LinuxCNC ran with the profile that an exported file states: the feed at every depth, and the time."""

import math
import sys

# Where the axis starts and stops it cannot have the profile's feed; the rest has to be within this part of it.
WITHIN = 0.02
# Acceleration of the simulated axis, mm/s².
ACCELERATION = 2000.0


def knots(program):
    found = []
    with open(program, encoding="ascii") as lines:
        for line in lines:
            if line.startswith("(knot "):
                depth, feed = line[len("(knot "):].rstrip(")\n").split()
                found.append((float(depth), float(feed)))
    return found


def feed_at(found, depth):
    for (left, low), (right, high) in zip(found, found[1:]):
        if left <= depth <= right:
            return low + (depth - left) / (right - left) * (high - low)
    raise ValueError(depth)


def time_between(found, start, end):
    total = 0.0
    for (left, low), (right, high) in zip(found, found[1:]):
        a, b = max(left, start), min(right, end)
        if a < b:
            fa, fb = feed_at(found, a), feed_at(found, b)
            mean = fa if abs(fb - fa) < 1e-9 else (fb - fa) / math.log(fb / fa)
            total += (b - a) / mean * 60.0
    return total


def main():
    program, record = sys.argv[1], sys.argv[2]
    found = knots(program)
    end = found[-1][0]
    rows = []
    lost = 0
    before = None
    with open(record, encoding="ascii") as lines:
        for line in lines:
            cells = line.split()
            if len(cells) != 3:
                lost += 1
                continue
            tick, z = int(cells[0]), float(cells[1])
            if before is not None and tick != before + 1:
                lost += 1
            before = tick
            rows.append(-z)
    if lost:
        sys.exit(f"{lost} samples were lost: the record says nothing")
    # The last stretch is braked from the last feed: v²/2a, and one servo period's way.
    last = found[-1][1] / 60.0
    braking = last * last / 2.0 / ACCELERATION + last * 0.001
    worst, at, compared = 0.0, 0.0, 0
    first = next(k for k, depth in enumerate(rows) if depth > 0.0)
    deepest = max(range(len(rows)), key=lambda k: rows[k])
    # Over ten servo periods, so that the resolution of one does not count.
    for k in range(first, deepest - 10):
        a, b = rows[k], rows[k + 10]
        if a < 0.01 or b > end - braking or b <= a:
            continue
        feed = (b - a) / 0.010 * 60.0
        wanted = (b - a) / time_between(found, a, b) * 60.0
        off = abs(feed / wanted - 1.0)
        compared += 1
        if off > worst:
            worst, at = off, a
    inside = [k for k in range(first, deepest) if 0.01 <= rows[k] <= end - braking]
    took = (inside[-1] - inside[0]) * 0.001
    meant = time_between(found, rows[inside[0]], rows[inside[-1]])
    print(f"{compared} stretches of 10 ms, feed at most {worst:.2%} off (at {at:.2f} mm); "
          f"{took:.3f} s for {meant:.3f} s, {took / meant - 1.0:+.2%}; deepest {max(rows):.4f} of {end:.4f} mm")
    if compared < 500 or worst > WITHIN or abs(took / meant - 1.0) > WITHIN or abs(max(rows) - end) > 0.001:
        sys.exit("the feed does not follow the profile within 2 %")


main()
