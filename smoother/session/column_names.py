"""What a column of another program's table holds, by its name: a quantity and its unit, however a program spells them.

A name is a word for the quantity, with a unit in brackets or behind it, and maybe with the source behind an asterisk.
Imports nothing of this project.
"""

import re
from dataclasses import dataclass

_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_SOURCE = re.compile(r"\*\s*(\w+)\s*$")
_NO_LETTER = re.compile(r"[\W_]")
MADE_UP = ("calc", "obd")  # sources that are no receiver and no sensor of motion
WORDS: dict[str, tuple[str, ...]] = {  # quantity: letters and digits of its names, the best first
    "latitude": ("gpslatitude", "gpslat", "latitude", "lat", "breite", "breitengrad"),
    "longitude": (
        *("gpslongitude", "gpslong", "gpslon", "gpslng", "longitude", "long", "lon", "lng"),
        *("länge", "laenge", "längengrad", "laengengrad", "lnge", "lngengrad"),  # the last of a text that lost its ä
    ),
    "time": (
        *("time", "timestamp", "utctime", "timeutc", "utc", "gpstime", "gpstimestamp", "fixtime", "datetime"),
        *("timedate", "unixtime", "epoch", "devicetime", "localtime", "secondselapsed", "elapsedtime", "elapsed"),
        *("millis", "milliseconds", "micros", "microseconds", "cts", "timeofday", "t", "zeit", "uhrzeit"),
    ),
    "date": ("date", "utcdate", "dateutc", "gpsdate", "datum"),
    "speed": (
        *("gpsspeed", "groundspeed", "speedoverground", "gps2dspeed", "gps2d", "speed", "velocity", "gpsvelocity"),
        *("speed2d", "sog", "kph", "kmh", "mph", "geschwindigkeit"),
    ),
    "course": (
        *("gpsheading", "gpscourse", "gpsbearing", "heading", "course", "bearing", "direction", "cog"),
        *("courseoverground", "trackangle", "richtung", "kurs"),
    ),
    "altitude": ("gpsaltitude", "gpsalt", "altitude", "alt", "height", "elevation", "ele", "höhe", "hoehe", "hhe"),
    "accuracy": (
        *("horizontalaccuracy", "hacc", "gpsaccuracy", "gpsposaccuracy", "posaccuracy", "accuracy"),
        *("horizontalegenauigkeit", "genauigkeit"),
    ),
    "height accuracy": ("verticalaccuracy", "vacc", "altitudeaccuracy"),
    "speed accuracy": ("speedaccuracy", "sacc", "gpsspdaccuracy"),
    "hdop": ("hdop", "gpshdop", "horizontaldilutionofprecision", "hop"),
    "satellites": ("satellites", "sats", "numsats", "numsv", "satcount", "gpssats", "gpssatellites", "gpsnsat", "nsat"),
    "fix": ("fix", "fixtype", "gpsfix", "gpsfixtype", "fixquality"),
    "update": ("gpsupdate",),
    **{
        f"a{axis}": (
            *(f"gforce{axis}", f"a{axis}", f"acc{axis}", f"accel{axis}", f"acceleration{axis}"),
            *(f"accelerometer{axis}", f"{axis}acceleration", f"{axis}acc", f"{axis}accel"),
        )
        for axis in "xyz"
    },
    **{
        f"g{axis}": (
            *(f"g{axis}", f"gyro{axis}", f"gyr{axis}", f"gyroscope{axis}", f"{axis}gyro", f"{axis}rateofrotation"),
            *(f"rotationrate{axis}", f"angularvelocity{axis}", f"w{axis}", f"omega{axis}"),
        )
        for axis in "xyz"
    },
}
_OF_ANGLE = {"deg": "deg", "degree": "deg", "degrees": "deg"}
_OF_LENGTH = {"mm": "mm", "cm": "cm", "m": "m", "meters": "m", "ft": "ft", "feet": "ft"}
_OF_SPEED = {
    **{"kmh": "km/h", "kph": "km/h", "kmph": "km/h", "mph": "mph", "knots": "knots", "kts": "knots", "kn": "knots"},
    **{"mps": "m/s", "ms": "m/s"},
}
_OF_TIME = {
    **{"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "millis": "ms", "msec": "ms"},
    **{"us": "us", "micros": "us", "ns": "ns"},
}
_OF_FORCE = {"g": "g", "ms2": "m/s2", "mss": "m/s2", "mps2": "m/s2"}
_OF_RATE = {"dps": "deg/s", "degs": "deg/s", "degps": "deg/s", "rads": "rad/s", "radps": "rad/s"}
SUFFIXES: dict[str, dict[str, str]] = {  # quantity: what may stand behind its name, and which unit it means
    **dict.fromkeys(("latitude", "longitude", "course"), _OF_ANGLE),
    **dict.fromkeys(("altitude", "accuracy", "height accuracy"), _OF_LENGTH),
    **dict.fromkeys(("speed", "speed accuracy"), _OF_SPEED),
    "time": _OF_TIME,
    **dict.fromkeys(("ax", "ay", "az"), _OF_FORCE),
    **dict.fromkeys(("gx", "gy", "gz"), _OF_RATE),
}
UNITS_OF_WORDS = {  # that say it themselves
    **{"kph": "km/h", "kmh": "km/h", "mph": "mph", "millis": "ms", "milliseconds": "ms", "cts": "ms"},
    **{"micros": "us", "microseconds": "us", "gforcex": "g", "gforcey": "g", "gforcez": "g"},
}
_MEANT = {
    word + suffix: (quantity, word, unit)
    for quantity, suffixes in SUFFIXES.items()
    for word in WORDS[quantity]
    for suffix, unit in suffixes.items()
} | {word: (quantity, word, UNITS_OF_WORDS.get(word, "")) for quantity, words in WORDS.items() for word in words}


@dataclass(frozen=True)
class Meaning:
    """What a column holds. `unit` in lower case, "" where the name does not say; `rank` 0 for the best of its names."""

    quantity: str
    unit: str
    rank: int


def meaning_of(name: str) -> Meaning | None:
    """Return what a column of that name holds, None for whatever takes no part in a recording of motion."""
    text = name.strip(' "').lower()
    if (source := _SOURCE.search(text)) is not None:
        if source[1] in MADE_UP:
            return None
        text = text[: source.start()].strip()
    brackets = _BRACKETS.search(text)
    word = _NO_LETTER.sub("", text[: brackets.start()] if brackets else text)
    if word not in _MEANT:
        return None
    quantity, bare, unit = _MEANT[word]
    return Meaning(quantity, (brackets[1].strip() if brackets else "") or unit, WORDS[quantity].index(bare))
