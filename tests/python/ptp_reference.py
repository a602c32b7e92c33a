#!/usr/bin/env python3
"""Independent reference of the peak-to-peak controller (Ivanov et al. 2024, Eq. 1-7).

Written from the equations, not from the Rust code: state in plain variables, times in seconds, crossings found from
a list of the signs seen so far. Makes the fixture that the Rust test compares with, to 1e-9:

    python3 tests/python/ptp_reference.py > service/core/tests-data/ptp_filtered.csv

Only the standard library is used.
"""

import math

CASES = [
    # name, f0 Hz, dt s, A0 mm, c1, c2, Tb s, g1, g2, fA Hz or None, aW, signal
    ("default", 70.86, 3e-4, 0.06, 1.0, 1.0, 0.07, 0.2, 0.2, 50.0, 0.3, "ramp"),
    ("slow-filter", 70.86, 3e-4, 0.06, 1.0, 1.0, 0.07, 0.2, 0.2, 20.0, 0.1, "beat"),
    ("fast-filter", 70.86, 3e-4, 0.06, 0.5, 2.0, 0.05, 0.1, 0.3, 200.0, 1.0, "beat"),
    ("other-head", 110.0, 1e-4, 0.1, 1.0, 1.0, 0.045, 0.2, 0.2, 80.0, 0.5, "ramp"),
    ("exact-zeros", 100.0, 5e-4, 0.05, 1.0, 1.0, 0.05, 0.2, 0.2, 50.0, 0.3, "square"),
]
SAMPLES = 600
KEPT = 25


def signal(kind, t, j):
    """Velocity in mm/s and acceleration in mm/s^2 at sample j."""
    if kind == "ramp":
        w = 2 * math.pi * 80
        a = 0.12 * min(t / 0.3, 1.0)
        return a / 2 * w * math.cos(w * t), -a / 2 * w * w * math.sin(w * t)
    if kind == "beat":
        w1, w2 = 2 * math.pi * 76, 2 * math.pi * 83
        v = 0.03 * w1 * math.cos(w1 * t) + 0.02 * w2 * math.cos(w2 * t + 0.4)
        return v, -0.03 * w1 * w1 * math.sin(w1 * t) - 0.02 * w2 * w2 * math.sin(w2 * t + 0.4)
    # A velocity that rests at exactly zero between its halves, with a period of 20 samples.
    v = [0.0, 8.0, 16.0, 20.0, 20.0, 20.0, 16.0, 8.0, 0.0, 0.0, -0.0, -8.0, -16.0, -20.0, -20.0, -20.0, -16.0, -8.0, 0.0, 0.0]
    return v[j % 20], 5000.0 * math.sin(2 * math.pi * j / 20 + 1.0)


def run(f0, dt, a0, c1, c2, tb, g1, g2, f_a, a_w, kind):
    alpha = 1.0 if f_a is None else 1.0 - math.exp(-2 * math.pi * f_a * dt)
    omega, amplitude, bc = 2 * math.pi * f0, 0.0, 0.0
    signs, last_crossing = [], None
    for j in range(SAMPLES):
        t = j * dt
        v, acc = signal(kind, t, j)
        if v > 0 and signs and signs[-1] < 0:
            if last_crossing is not None:
                omega += a_w * (2 * math.pi / (t - last_crossing) - omega)
            last_crossing = t
        if v != 0:
            signs.append(math.copysign(1, v))
        raw = 2 * math.hypot(v / omega, acc / omega**2)
        previous = amplitude
        amplitude = previous + alpha * (raw - previous)
        bc -= c1 * (amplitude / a0 - 1) * dt / tb + c2 * (amplitude - previous) / a0
        bc = max(-1.0, min(1.0, bc))
        if amplitude < (1 - g1) * a0:
            b = 1.0
        elif amplitude > (1 + g2) * a0:
            b = -1.0
        else:
            b = bc
        yield j, v, acc, omega, raw, amplitude, bc, b


print("# Made by tests/python/ptp_reference.py; do not edit.")
print("# case,name,f0_hz,dt_s,A0_mm,c1,c2,Tb_s,g1,g2,fA_hz,aW; then a row v,acc per sample, every 25th with omega,raw,A,bc,b.")
for name, *settings, kind in CASES:
    print(",".join(["case", name] + [repr(x) for x in settings]))
    for row in run(*settings, kind):
        j, v, acc, *rest = row
        fields = [repr(v), repr(acc)]
        if j % KEPT == KEPT - 1:
            fields += [repr(x) for x in rest]
        print(",".join(fields))
