#!/usr/bin/env python3
"""Writes cycles in Feedwright's binary form, application/vnd.feedwright.cycle, with nothing but the standard library.

    python3 feedwright_cycle.py < cycle.json > cycle.bin            one cycle, as it is posted in JSON
    python3 feedwright_cycle.py --batch < cycles.ndjson > cycles.bin

As a module: encode(cycle) takes the same fields as the JSON body (a dict; columns may be any sequence of numbers) and
returns the bytes of one frame; a batch is frame after frame. docs/cycle-format.md lays the bytes out.
"""

import json
import math
import struct
import sys
import zlib
from datetime import datetime, timedelta, timezone
from decimal import Decimal

CHANNELS = {
    "depth_mm": 1,
    "feed_programmed_mm_min": 2,
    "feed_actual_mm_min": 3,
    "override_percent": 4,
    "operator_override_percent": 5,
    "feed_drive_load_percent": 6,
    "spindle_load_percent": 7,
    "spindle_speed_rpm": 8,
    "thrust_newtons": 9,
    "torque_newton_metres": 10,
    "spindle_power_watts": 11,
    "feed_drive_power_watts": 12,
    "spindle_current_amperes": 13,
    "feed_drive_current_amperes": 14,
    "feed_drive_torque_newton_metres": 15,
    "spindle_torque_newton_metres": 16,
}
REPORTED = (
    "energy_joules",
    "duration_ms",
    "max_depth_mm",
    "max_spindle_load_percent",
    "max_feed_drive_load_percent",
    "mean_spindle_load_percent",
    "mean_feed_drive_load_percent",
    "operator_override_percent",
    "cutting_speed_m_min",
    "feed_mm_rev",
    "spindle_power_watts",
    "thrust_newtons",
    "edge_wear_mm",
)
FIELDS = {
    "cycle_id", "tool", "operation", "started_at", "seq", "process", "strategy", "law_version", "profile",
    "recommendation_id", "reference_cycle", "spindle_speed_rpm", "outcome", "samples", "reported",
}
MOST_PLACES = 9
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def encode(cycle):
    """The bytes of one cycle. Raises KeyError or ValueError where a field is missing, unknown or cannot be written."""
    unknown = set(cycle) - FIELDS
    if unknown:
        raise ValueError(f"not a field of a cycle: {sorted(unknown)}")
    parts = [_text(cycle["cycle_id"]), _text(cycle["tool"]), _text(cycle["operation"])]
    parts.append(struct.pack("<q", _microseconds(cycle["started_at"])))
    present = 0

    def optional(bit, value, write):
        nonlocal present
        if value is not None:
            present |= 1 << bit
            parts.append(write(value))

    optional(0, cycle.get("seq"), lambda seq: struct.pack("<Q", seq))
    optional(1, cycle.get("process"), _text)
    optional(2, cycle.get("strategy"), _text)
    optional(3, cycle.get("law_version"), _text)
    optional(4, cycle.get("profile"), lambda it: _text(it["id"]) + struct.pack("<I", it["version"]))
    optional(5, cycle.get("recommendation_id"), _text)
    optional(6, cycle.get("spindle_speed_rpm"), lambda speed: struct.pack("<d", speed))
    outcome = cycle.get("outcome")
    # A completed cycle need not say so.
    optional(7, None if outcome == "completed" else outcome, _text)
    optional(8, cycle.get("samples"), _samples)
    optional(9, cycle.get("reported") or None, _reported)
    reference = cycle.get("reference_cycle")
    # One bit each: there is nothing to follow.
    present |= {None: 0, True: 1 << 10, False: 1 << 11}[reference]
    payload = struct.pack("<I", present) + b"".join(parts)
    frame = b"FWC\x01" + struct.pack("<I", len(payload)) + payload
    return frame + struct.pack("<I", zlib.crc32(frame))


def _text(text):
    data = text.encode("utf-8")
    if len(data) > 255:
        raise ValueError(f"longer than 255 bytes: {text[:40]!r}")
    return bytes([len(data)]) + data


def _microseconds(started_at):
    if isinstance(started_at, int):
        return started_at
    if isinstance(started_at, str):
        started_at = datetime.fromisoformat(started_at.replace("Z", "+00:00"))
    if started_at.tzinfo is None:
        raise ValueError("started_at needs an offset from UTC")
    return (started_at - EPOCH) // timedelta(microseconds=1)


def _samples(samples):
    samples = dict(samples)
    period, times = samples.pop("period_ms", None), samples.pop("time_ms", None)
    if (period is None) == (times is None):
        raise ValueError("samples need period_ms or time_ms, and not both")
    columns = sorted((CHANNELS[name], values) for name, values in samples.items())
    lengths = {len(values) for _, values in columns} | ({len(times)} if times is not None else set())
    if not columns or len(lengths) != 1:
        raise ValueError("samples need at least one channel, and columns of one length")
    out = [b"\0" + struct.pack("<d", period) if times is None else b"\1", struct.pack("<I", lengths.pop())]
    if times is not None:
        out.append(_column(times))
    out.append(bytes([len(columns)]))
    for code, values in columns:
        out.append(bytes([code]) + _column(values))
    return b"".join(out)


def _reported(reported):
    unknown = set(reported) - set(REPORTED)
    if unknown:
        raise ValueError(f"not a value that is reported: {sorted(unknown)}")
    present, values = 0, []
    for bit, name in enumerate(REPORTED):
        if reported.get(name) is not None:
            present |= 1 << bit
            values.append(struct.pack("<d", reported[name]))
    return struct.pack("<H", present) + b"".join(values)


def _column(values):
    values = [float(value) + 0.0 for value in values]
    decimal = _decimals(values)
    if decimal is None:
        return b"\x0f" + struct.pack(f"<{len(values)}d", *values)
    places, integers = decimal
    out, before = bytearray([places]), 0
    for integer in integers:
        difference = integer - before
        zigzag = difference * 2 if difference >= 0 else -difference * 2 - 1
        while zigzag >= 0x80:
            out.append(zigzag & 0x7F | 0x80)
            zigzag >>= 7
        out.append(zigzag)
        before = integer
    return bytes(out)


def _decimals(values):
    """The smallest number of places that all values have, with their integers; None where there is none up to 9."""
    places = 0
    for value in values:
        if not math.isfinite(value):
            return None
        # The shortest decimal that leads back to the float: what was measured, not what the float is exactly.
        exponent = Decimal(repr(value)).normalize().as_tuple().exponent
        places = max(places, -exponent)
        if places > MOST_PLACES:
            return None
    integers = [int((Decimal(repr(value)).scaleb(places)).to_integral_value()) for value in values]
    exact = all(
        abs(integer) < 2**53 and integer / 10**places == value for integer, value in zip(integers, values)
    )
    return (places, integers) if exact else None


def main():
    write = sys.stdout.buffer.write
    if "--batch" in sys.argv[1:]:
        for line in sys.stdin:
            if line.strip():
                write(encode(json.loads(line)))
    else:
        write(encode(json.load(sys.stdin)))


if __name__ == "__main__":
    main()
