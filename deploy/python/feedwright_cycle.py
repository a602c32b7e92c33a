#!/usr/bin/env python3
"""Writes cycles in Feedwright's binary form, application/vnd.feedwright.cycle, with nothing but the standard library.

    python3 feedwright_cycle.py < cycle.json > cycle.bin            one cycle, as it is posted in JSON
    python3 feedwright_cycle.py --batch < cycles.ndjson > cycles.bin

As a module: encode(cycle) takes the same fields as the JSON body, a dict, and returns the bytes of one frame; a batch is
frame after frame. Numbers are int, float or what else is a real number (numbers.Real, as NumPy's are), and columns any
sequence of them; started_at may be a datetime with an offset too. What JSON could not say is refused here, and what is out of its range by
the service, as in JSON. docs/cycle-format.md lays the bytes out.
"""

import json
import math
import re
import struct
import sys
import zlib
from datetime import date, datetime, timedelta, timezone
from decimal import Decimal
from numbers import Integral, Real

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
# RFC 3339, whose separator may be a space. Not datetime.fromisoformat: it reads other forms too, and not all of these.
TIME = re.compile(
    r"([0-9]{4})-([0-9]{2})-([0-9]{2})[Tt ]([0-9]{2}):([0-9]{2}):([0-9]{2})(?:\.([0-9]+))?"
    r"(?:([Zz])|([+-])([0-9]{2}):([0-9]{2}))"
)
# 0001-01-01T00:00:00Z and the end of the second 9999-12-30T22:00:00Z.
FIRST_US, LAST_US = -62_135_596_800_000_000, 253_402_207_200_999_999


def encode(cycle):
    """The bytes of one cycle. Raises KeyError or ValueError where a field is missing, unknown or cannot be written."""
    _known("cycle", cycle, FIELDS)
    parts = [_text(cycle["cycle_id"]), _text(cycle["tool"]), _text(cycle["operation"])]
    parts.append(struct.pack("<q", _microseconds(cycle["started_at"])))
    present = 0

    def optional(bit, value, write):
        nonlocal present
        if value is not None:
            present |= 1 << bit
            parts.append(write(value))

    optional(0, cycle.get("seq"), lambda seq: struct.pack("<Q", _whole(seq, 64)))
    optional(1, cycle.get("process"), _text)
    optional(2, cycle.get("strategy"), _text)
    optional(3, cycle.get("law_version"), _text)
    optional(4, cycle.get("profile"), _profile)
    optional(5, cycle.get("recommendation_id"), _text)
    optional(6, cycle.get("spindle_speed_rpm"), lambda speed: struct.pack("<d", _number(speed)))
    outcome = cycle.get("outcome")
    # A completed cycle need not say so.
    optional(7, None if outcome == "completed" else outcome, _text)
    optional(8, cycle.get("samples"), _samples)
    reported = cycle.get("reported")
    optional(9, None if reported == {} else reported, _reported)
    reference = cycle.get("reference_cycle")
    if not (reference is None or isinstance(reference, bool)):
        raise ValueError(f"reference_cycle is neither true nor false: {reference!r}")
    # One bit each: there is nothing to follow.
    present |= 0 if reference is None else 1 << 10 if reference else 1 << 11
    payload = struct.pack("<I", present) + b"".join(parts)
    frame = b"FWC\x01" + struct.pack("<I", len(payload)) + payload
    return frame + struct.pack("<I", zlib.crc32(frame))


def _known(what, fields, names):
    if not isinstance(fields, dict):
        raise ValueError(f"{what} is no dict: {fields!r:.40}")
    unknown = set(fields) - set(names)
    if unknown:
        raise ValueError(f"not a field of {what}: {sorted(map(str, unknown))}")


def _text(text):
    if not isinstance(text, str):
        raise ValueError(f"not a text: {text!r:.40}")
    data = text.encode("utf-8")
    if len(data) > 255:
        raise ValueError(f"longer than 255 bytes: {text[:40]!r}")
    return bytes([len(data)]) + data


def _whole(value, bits):
    # True and False are integers to Python, and nowhere else.
    if not isinstance(value, Integral) or isinstance(value, bool) or not 0 <= value < 1 << bits:
        raise ValueError(f"not a whole number from 0 to {(1 << bits) - 1}: {value!r:.40}")
    return value


def _number(value):
    if not isinstance(value, Real) or isinstance(value, bool):
        raise ValueError(f"not a number: {value!r:.40}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("not a finite number")
    # −0 is 0.
    return number + 0.0


def _profile(profile):
    _known("profile", profile, ("id", "version"))
    return _text(profile["id"]) + struct.pack("<I", _whole(profile["version"], 32))


def _microseconds(started_at):
    if isinstance(started_at, str):
        at = _read(started_at)
    elif isinstance(started_at, datetime) and started_at.utcoffset() is not None:
        at = (started_at - EPOCH) // timedelta(microseconds=1)
    else:
        raise ValueError(f"started_at is neither a text nor a datetime with an offset from UTC: {started_at!r:.40}")
    if not FIRST_US <= at <= LAST_US:
        raise ValueError("started_at is not from 0001-01-01T00:00:00Z to 9999-12-30T22:00:00Z")
    return at


def _read(text):
    """Microseconds since 1970 of an RFC 3339 time; of a finer one, the last whole one before it."""
    form = TIME.fullmatch(text)
    if not form:
        raise ValueError(f"started_at is no RFC 3339 time with an offset, as 2026-05-04T06:00:00Z: {text[:40]!r}")
    year, month, day, hour, minute, second = map(int, form.group(1, 2, 3, 4, 5, 6))
    fraction, zulu, sign, offset_hours, offset_minutes = form.group(7, 8, 9, 10, 11)
    # A leap second ends a day of UTC, and is read as the second before it. Any other is one that a control rounded up.
    if (hour, minute, second) == (23, 59, 60) and zulu == "Z":
        second = 59
    offset = 0
    if sign:
        offset_hours, offset_minutes = int(offset_hours), int(offset_minutes)
        offset = (offset_hours * 60 + offset_minutes) * (-60 if sign == "-" else 60)
    if hour > 23 or minute > 59 or second > 59 or sign and (offset_hours > 23 or offset_minutes > 59):
        raise ValueError(f"started_at is no time that there is: {text[:40]!r}")
    # Years repeat after 400: Python has no year 0, in which the first time begins with an offset.
    days = date(year or 400, month, day).toordinal() - (0 if year else 146_097) - EPOCH.toordinal()
    seconds = ((days * 24 + hour) * 60 + minute) * 60 + second - offset
    return seconds * 1_000_000 + int((fraction or "")[:6].ljust(6, "0"))


def _samples(samples):
    _known("samples", samples, ("period_ms", "time_ms", *CHANNELS))
    columns = dict(samples)
    if ("period_ms" in columns) == ("time_ms" in columns):
        raise ValueError("samples need period_ms or time_ms, and not both")
    period, times = columns.pop("period_ms", None), columns.pop("time_ms", None)
    is_timed = "time_ms" in samples
    columns = sorted(((CHANNELS[name], _numbers(values)) for name, values in columns.items()), key=lambda it: it[0])
    times = _numbers(times) if is_timed else None
    lengths = {len(values) for _, values in columns} | ({len(times)} if is_timed else set())
    if not columns or len(lengths) != 1:
        raise ValueError("samples need at least one channel, and columns of one length")
    out = [b"\1" if is_timed else b"\0" + struct.pack("<d", _number(period)), struct.pack("<I", lengths.pop())]
    if is_timed:
        out.append(_column(times))
    out.append(bytes([len(columns)]))
    for code, values in columns:
        out.append(bytes([code]) + _column(values))
    return b"".join(out)


def _reported(reported):
    _known("reported", reported, REPORTED)
    present, values = 0, []
    for bit, name in enumerate(REPORTED):
        if reported.get(name) is not None:
            present |= 1 << bit
            values.append(struct.pack("<d", _number(reported[name])))
    return struct.pack("<H", present) + b"".join(values)


def _numbers(values):
    # A text has elements too, and so has a dict.
    if isinstance(values, (str, bytes, bytearray, dict)) or not hasattr(values, "__getitem__"):
        raise ValueError(f"not a sequence of numbers: {values!r:.40}")
    return [_number(value) for value in values]


def _column(values):
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


def _read_json(data):
    """One cycle of JSON, read as strictly as the service does."""
    return json.loads(data.decode("utf-8"), object_pairs_hook=_once)


def _once(pairs):
    fields = dict(pairs)
    if len(fields) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"given twice: {sorted(name for name in fields if names.count(name) > 1)}")
    return fields


def main():
    read, write = sys.stdin.buffer, sys.stdout.buffer.write
    if "--batch" in sys.argv[1:]:
        for line in read:
            if line.strip():
                write(encode(_read_json(line)))
    else:
        write(encode(_read_json(read.read())))


if __name__ == "__main__":
    main()
