"""Column headers with units in them: `yaw_pos [deg]`, `speed (rpm)`, `time_ms`."""

from __future__ import annotations

import dataclasses
import re

from orbisim.recording import names, units

_BRACKETS = re.compile(r"(?s)(.*?)\s*[\[(]([^\[\]()]*)[\])]\s*")
_SUFFIXES = {
    **{text: text for text in (
        "deg", "degs", "degree", "degrees", "rad", "radian", "radians", "mrad", "rpm", "rps",
        "dps", "ms", "us", "ns", "sec", "secs", "msec", "usec", "nsec", "seconds", "mm", "cm",
        "um", "mps", "Nm", "mNm", "Ncm", "mN", "mA", "mV",
    )},
    "rads": "rad/s", "radps": "rad/s", "degps": "deg/s",
    "rad_s": "rad/s", "deg_s": "deg/s", "rad_per_s": "rad/s", "deg_per_s": "deg/s",
    "rad_s2": "rad/s^2", "deg_s2": "deg/s^2", "m_s": "m/s", "m_s2": "m/s^2", "mps2": "m/s^2",
    "mm_s": "mm/s", "nm": "Nm",
}  # fmt: skip
"""Last parts of names that are units. Single letters are left out: `motor_A`, `left_m`."""
_LONGEST = 300
"""Characters of a header that is looked into."""
_PLAIN = f" [{units.AS_IT_IS}]"
_TIMES = ("time", "timestamp", "timestamps", "t", "stamp", "time_stamp", "elapsed", "elapsed_time")


@dataclasses.dataclass(frozen=True)
class Label:
    """A header. name: without the unit. unit: as written, None if there is none."""

    name: str
    unit: str | None


def parse(header: str) -> Label:
    """Name and unit of a header.

    What stands in the last brackets is a unit if it is a known one (`ball[3]` is an index, `arm
    [left]` a name). A unit after an underline counts only in names that are not those of signals:
    a joint may be called `arm_deg`.
    """
    header = header.lstrip()  # behind a comma and a space
    if len(header) > _LONGEST:
        return Label(header, None)
    if header.endswith(_PLAIN):
        return Label(header.removesuffix(_PLAIN), units.AS_IT_IS)
    match = _BRACKETS.fullmatch(header)
    if match and match[1] and not match[2].strip().isdigit() and units.known(match[2].strip()):
        unit = match[2].strip()
        return Label(match[1], unit or "1") if unit else Label(header, None)
    if names.is_signal(header):
        return Label(header, None)
    for suffix, unit in sorted(_SUFFIXES.items(), key=lambda item: -len(item[0])):
        if header.endswith("_" + suffix) and len(header) > len(suffix) + 1:
            return Label(header[: -len(suffix) - 1], unit)
    name = header.removesuffix("_s")
    return Label(name, "s") if name != header and is_time(name) else Label(header, None)


def is_time(name: str) -> bool:
    """Whether a name (without its unit) is that of a time column."""
    return name.strip().rpartition("/")[2].lower() in _TIMES


def escaped(name: str) -> str:
    """A header that `parse` gives back as this name, without a unit."""
    return name if parse(name) == Label(name, None) else f"{name}{_PLAIN}"
