"""What a column of another program's table holds, by its name: a quantity and its unit, however a program spells them.

A name is a word for the quantity, with a unit in brackets or behind it, and maybe with the source behind an asterisk.
"""

import re
from dataclasses import dataclass

from smoother.session.readers.cells import SEMICIRCLE
from smoother.units import DEG, FOOT, KMH, KNOT, MPH, STANDARD_GRAVITY

_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_SOURCE = re.compile(r"\*\s*(\w+)\s*$")
_NO_LETTER = re.compile(r"[\W_]")
COMPUTED = ("calc", "obd")  # sources that are no receiver and no sensor of motion
WORDS: dict[str, tuple[str, ...]] = {  # quantity: letters and digits of its names, the best first
    "latitude": (
        *("gpslatitude", "gpslat", "latitude", "lat", "positionlat", "latitudens", "latitud", "latitudine"),
        *("breite", "breitengrad"),
    ),
    "longitude": (
        *("gpslongitude", "gpslong", "gpslon", "gpslng", "longitude", "long", "lon", "lng", "positionlong"),
        *("longitudeew", "longitud", "longitudine", "länge", "laenge", "längengrad", "laengengrad"),
        *("lnge", "lngengrad"),  # of a text that lost its ä
    ),
    "time": (
        *("time", "timestamp", "utctime", "timeutc", "utc", "gpstime", "gpstimestamp", "fixtime", "datetime"),
        *("timedate", "dateandtime", "unixtime", "epoch", "devicetime", "interval", "localtime", "secondselapsed"),
        *("elapsedtime", "elapsed", "millis", "milliseconds", "micros", "microseconds", "cts", "timeofday", "t"),
        *("sessiontime", "loggertime", "clock", "zeit", "uhrzeit", "zeitstempel", "heure", "temps", "hora", "ora"),
        *("tempo", "tiempo"),
    ),
    "date": ("utcdate", "dateutc", "date", "gpsdate", "datum", "fecha", "localdate"),
    "speed": (
        *("gpsspeed", "groundspeed", "speedoverground", "gps2dspeed", "gps2d", "speed", "velocity", "gpsvelocity"),
        *(
            "speed2d",
            "enhancedspeed",
            "sog",
            "kph",
            "kmh",
            "mph",
            "geschwindigkeit",
            "vitesse",
            "velocidad",
            "velocità",
        ),
        *("velocita", "gps3dspeed"),
    ),
    "course": (
        *("gpsheading", "gpscourse", "gpsbearing", "heading", "course", "bearing", "direction", "cog"),
        *("courseoverground", "trackangle", "richtung", "kurs", "cap", "rumbo"),
    ),
    "altitude": (
        *("gpsaltitude", "gpsalt", "altitude", "alt", "height", "enhancedaltitude", "elevation", "ele"),
        *("höhe", "hoehe", "hhe", "altitud", "altitudine", "quota"),
    ),
    "accuracy": (
        *("horizontalaccuracy", "hacc", "gpsaccuracy", "gpsposaccuracy", "gpspositionaccuracy", "posaccuracy"),
        *("accuracy", "accuracyhorizontal", "horizontalegenauigkeit", "genauigkeit"),
    ),
    "height accuracy": ("verticalaccuracy", "vacc", "altitudeaccuracy"),
    "speed accuracy": ("speedaccuracy", "sacc", "gpsspdaccuracy", "gpsvelocityaccuracy"),
    "hdop": ("hdop", "gpshdop", "horizontaldilutionofprecision", "hop"),
    "satellites": (
        *("satellites", "sats", "numsats", "numsv", "satcount", "gpssats", "gpssatellites", "gpsnsat", "nsat"),
    ),
    "fix": ("fix", "fixtype", "gpsfix", "gpsfixtype", "fixquality", "gpsqual", "valid"),
    "north": ("velnorth", "velocitynorth"),
    "east": ("veleast", "velocityeast"),
    "up": ("velup", "velocityup"),
    "update": ("gpsupdate",),
    "year": ("year", "jahr", "année", "anno", "año"),
    "month": ("month", "monat", "mois", "mese", "mes"),
    "day": ("day", "tag", "jour", "giorno", "día"),
    "hour": ("hour", "hours", "hh", "stunde", "heures", "ore", "horas"),
    "minute": ("minute", "minutes", "min", "mm"),
    "second": ("second", "seconds", "sec", "ss", "sekunde", "secondi", "segundo"),
    "millisecond": ("ms", "msec", "millisecond", "millisec", "utcms", "timems"),
    **{
        f"a{axis}": (
            *(f"totalacceleration{axis}", f"gforce{axis}", f"a{axis}", f"acc{axis}", f"accel{axis}"),
            *(f"acceleration{axis}", f"accelerometer{axis}", f"{axis}acceleration", f"{axis}acc", f"{axis}accel"),
            *(f"accelerometeruncalibrated{axis}",),
        )
        for axis in "xyz"
    },
    **{
        f"g{axis}": (
            *(f"g{axis}", f"gyro{axis}", f"gyr{axis}", f"gyroscope{axis}", f"{axis}gyro", f"{axis}rateofrotation"),
            *(f"rotationrate{axis}", f"angularvelocity{axis}", f"w{axis}", f"omega{axis}", f"{axis}gyroscope"),
            *(f"gyroscopeuncalibrated{axis}",),
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
ANGLES_OF_TURNING = {"roll": "gx", "pitch": "gy", "yaw": "gz"}  # named so, their rates, where the unit is one of rates
SPEED_UNITS = {
    **dict.fromkeys(("km/h", "kmh", "kph", "km/hr", "kmph"), KMH),
    **dict.fromkeys(("m/s", "mps", "m/sec", "meters/second", "metres/second"), 1.0),
    **dict.fromkeys(("mph", "mi/h", "mi/hr"), MPH),
    **dict.fromkeys(("knots", "knot", "kn", "kt", "kts"), KNOT),
    "mm/s": 1e-3,
}
LENGTH_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "meters": 1.0, "ft": FOOT, "feet": FOOT}
FORCE_UNITS = {"g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
FORCE_UNITS |= dict.fromkeys(("m/s2", "m/s^2", "m/s²", "m/s/s"), 1.0)
RATE_UNITS = dict.fromkeys(("deg/s", "dps", "°/s", "deg/sec", "degrees/second"), DEG)
RATE_UNITS |= {"mdps": 1e-3 * DEG, "rad/s": 1.0, "rad/sec": 1.0}
ANGLE_UNITS = {
    **dict.fromkeys(("deg", "°", "degrees", "degree"), 1.0),
    **dict.fromkeys(("min", "minutes"), 1.0 / 60.0),
    "semicircles": SEMICIRCLE,
}
UNITS: dict[str, dict[str, float]] = {  # quantity: factor to SI, or to degrees, of the units it may have
    **dict.fromkeys(("latitude", "longitude", "course"), ANGLE_UNITS),
    **dict.fromkeys(("altitude", "accuracy", "height accuracy"), LENGTH_UNITS),
    **dict.fromkeys(("speed", "speed accuracy", "north", "east", "up"), SPEED_UNITS),
    **dict.fromkeys(("ax", "ay", "az"), FORCE_UNITS),
    **dict.fromkeys(("gx", "gy", "gz"), RATE_UNITS),
}
_OF_TIME = {
    **{"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "millis": "ms", "msec": "ms"},
    **{"us": "us", "micros": "us", "ns": "ns", "utc": "utc"},
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


def meaning_of(name: str, unit: str = "", sensor: str = "") -> Meaning | None:
    """Return what a column of that name holds, None for whatever takes no part in a recording of motion.

    unit : as a line below the names, or the file's form, has it. sensor : what the table is called after, for columns
    that are x, y and z.
    """
    text = name.strip(' "').lower()
    if (source := _SOURCE.search(text)) is not None:
        if source[1] in COMPUTED:
            return None
        text = text[: source.start()].strip()
    brackets = _BRACKETS.search(text)
    word = _NO_LETTER.sub("", text[: brackets.start()] if brackets else text)
    unit = (brackets[1].strip() if brackets else "") or unit.strip().lower()
    if word in ("x", "y", "z"):
        word = _NO_LETTER.sub("", sensor.lower()) + word
    if word in ANGLES_OF_TURNING and unit in RATE_UNITS:
        return Meaning(ANGLES_OF_TURNING[word], unit, 0)
    if word not in _MEANT:
        return None
    quantity, bare, usual = _MEANT[word]
    return Meaning(quantity, unit or usual, WORDS[quantity].index(bare))


def parts_of(name: str) -> tuple[str, str]:
    """The name and the unit of a column that is called, for example, Oil temp (C) or "RPM [rpm]"."""
    text = name.strip(' "')
    if (source := _SOURCE.search(text)) is not None:
        text = text[: source.start()].strip()
    brackets = _BRACKETS.search(text)
    return (text[: brackets.start()].strip(), brackets[1].strip()) if brackets else (text, "")
