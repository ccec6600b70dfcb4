"""NMEA sentences of a simulated receiver."""

from __future__ import annotations

from datetime import UTC, datetime


def sentence(body: str) -> str:
    """A sentence with its checksum."""
    checksum = 0
    for character in body:
        checksum ^= ord(character)
    return f"${body}*{checksum:02X}\r\n"


def angle(degrees: float, digits: int) -> str:
    """Degrees and minutes as in NMEA, without the hemisphere."""
    whole, minutes = divmod(abs(degrees) * 60, 60)
    return f"{int(whole):0{digits}d}{minutes:010.7f}"


def measurement(
    t_ns: int, latitude: float, longitude: float, height: float, *, quality: int = 1
) -> str:
    """RMC, GGA and GSA of one measurement at Unix time t_ns."""
    at = datetime.fromtimestamp(t_ns / 1e9, UTC)
    clock = at.strftime("%H%M%S.") + f"{at.microsecond // 10_000:02d}"
    ns, ew = "NS"[latitude < 0], "EW"[longitude < 0]
    place = f"{angle(latitude, 2)},{ns},{angle(longitude, 3)},{ew}" if quality else ",,,"
    status = "A" if quality else "V"
    return (
        sentence(f"GNRMC,{clock},{status},{place},10.0,0.0,{at:%d%m%y},,,A")
        + sentence(f"GNGGA,{clock},{place},{quality},09,0.9,{height - 47:.3f},M,47.0,M,,")
        + sentence("GNGSA,A,3,01,02,03,04,05,06,07,08,09,,,,1.6,0.9,1.3")
    )
