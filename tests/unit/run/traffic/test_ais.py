"""AIS encoder against published sentences, and against what pyais 3.3.1 read from ours."""

from __future__ import annotations

from dataclasses import replace

import pytest

from xitl_cli.run.traffic.ais import (
    MOORED,
    NO_TURN,
    AisDimensions,
    AisPayload,
    AisPosition,
    AisStatic,
    class_a_position,
    class_a_static,
    class_b_position,
    class_b_static,
    sentences,
    turn_indicator,
)

# Sample sentences of the gpsd project (AIVDM.adoc, test/sample.aivdm) and the values it states for them.
SEATTLE = AisPosition(
    477553000, 47.582833, -122.345833, 0.0, 51.0, 181.0, turn_rate_degpmin=0.0, second=15, status=MOORED
)
NEW_YORK = AisPosition(338087471, 40.684540, -74.072132, 0.1 * 1852 / 3600, 79.6, second=49, raim=True)
SAINT_LAWRENCE = AisPosition(
    371798000, 48.381633, -123.395383, 12.3 * 1852 / 3600, 224.0, 215.0, -720.0, accurate=True, second=33
)
EVER_DIADEM = AisStatic(
    351759000,
    "EVER DIADEM".ljust(20),
    "3FOF8".ljust(7),
    70,
    AisDimensions(225, 70, 1, 31),
    draught_m=12.2,
    imo=9134270,
    destination="NEW YORK".ljust(20),
    eta=(5, 15, 14, 0),
)
PROGUY = AisStatic(271041815, "PROGUY", "TC6163", 60, AisDimensions(0, 15, 0, 5), fixing_device=0)


def bits(characters: str) -> str:
    """The six bits of each armoured character, by the table of the gpsd project."""
    codes = [ord(one) - 48 for one in characters]
    return "".join(f"{code - 8 if code > 40 else code:06b}" for code in codes)


def test_a_class_a_position_is_the_published_sentence() -> None:
    assert sentences(class_a_position(SEATTLE, radio=149208), channel="B") == (
        b"!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C\r\n",
    )


def test_a_class_b_position_is_the_published_sentence() -> None:
    assert sentences(class_b_position(NEW_YORK), channel="A") == (
        b"!AIVDM,1,1,,A,B52K>;h00Fc>jpUlNV@ikwpUoP06,0*4C\r\n",
    )


def test_static_data_of_class_a_are_the_published_sentences() -> None:
    """Both parts: the publisher broke the payload at the same character."""
    assert sentences(class_a_static(EVER_DIADEM), sequence=1) == (
        b"!AIVDM,2,1,1,A,55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0*1C\r\n",
        b"!AIVDM,2,2,1,A,88888888880,2*25\r\n",
    )


def test_static_data_of_class_b_are_the_published_sentences() -> None:
    name, rest = class_b_static(PROGUY)
    assert sentences(name) == (b"!AIVDM,1,1,,A,H42O55i18tMET00000000000000,2*6D\r\n",)
    assert rest == AisPayload("H42O55lt0000000D3nink000?050", 0)


def test_a_published_turn_to_port_beyond_what_is_counted() -> None:
    """The sender had no turn indicator and said -127; one that has says -126 at most. All else is the same."""
    published = bits("15RTgt0PAso;90TKcjM8h6g208CQ")
    ours = bits(class_a_position(SAINT_LAWRENCE, radio=0b000_010_00010011100001).characters)
    assert published[:42] + published[50:] == ours[:42] + ours[50:]
    assert int(published[42:50], 2) - 256 == -127
    assert int(ours[42:50], 2) - 256 == -126


@pytest.mark.parametrize(
    ("rate_degpmin", "indicator"),
    [(0.0, 0), (1.0, 5), (-1.0, -5), (20.0, 21), (-20.0, -21), (708.0, 126), (5000.0, 126), (None, NO_TURN)],
)
def test_turn_indicator(rate_degpmin: float | None, indicator: int) -> None:
    """4.733 sqrt(rate): ITU-R M.1371-5, table 48, which ends at 708 degrees a minute."""
    assert turn_indicator(rate_degpmin) == indicator


def test_what_is_not_available_says_so() -> None:
    """Bits by table 48: turn -128, speed 1023, longitude 181, latitude 91, course 3600, heading 511, second 60."""
    said = bits(class_a_position(AisPosition(200000001, None, None)).characters)
    fields = [int(said[start:end], 2) for start, end in ((42, 50), (50, 60), (116, 128), (128, 137), (137, 143))]
    assert fields == [128, 1023, 3600, 511, 60]
    assert (int(said[61:89], 2), int(said[89:116], 2)) == (181 * 600_000, 91 * 600_000)


def test_limits_of_the_fields() -> None:
    fast = replace(SEATTLE, speed_mps=60.0, course_deg=359.97, heading_deg=359.6, lat_deg=-33.0, lon_deg=18.0)
    said = bits(class_a_position(fast).characters)
    assert [int(said[start:end], 2) for start, end in ((50, 60), (116, 128), (128, 137))] == [1022, 0, 0]
    assert int(said[89:116], 2) - (1 << 27) == -33 * 600_000


def test_dimensions_add_up_to_the_hull_and_are_never_nothing() -> None:
    """ArduPilot takes dimensions for known when none of the four is 0."""
    assert AisDimensions.around(2.0, 1.1) == AisDimensions(1, 1, 1, 1)
    assert AisDimensions.around(60.0, 12.0, ahead_m=10.0) == AisDimensions(40, 20, 6, 6)
    assert AisDimensions.around(2000.0, 300.0) == AisDimensions(511, 511, 63, 63)
    assert AisDimensions.around(4.0, 2.0, ahead_m=-3.0) == AisDimensions(1, 5, 1, 1)


def test_a_sentence_is_no_longer_than_82_characters_and_a_part_is_tied_to_the_next() -> None:
    parts = sentences(class_a_static(EVER_DIADEM), sequence=12)
    assert [len(part) <= 82 and part.endswith(b"\r\n") for part in parts] == [True, True]
    assert [part.split(b",")[1:4] for part in parts] == [[b"2", b"1", b"2"], [b"2", b"2", b"2"]]


def test_text_is_sent_in_capitals_and_what_is_not_there_as_a_question_mark() -> None:
    assert class_b_static(replace(PROGUY, name="Proguy"))[0] == class_b_static(PROGUY)[0]
    assert class_b_static(replace(PROGUY, name="Ö"))[0] == class_b_static(replace(PROGUY, name="?"))[0]
    assert class_b_static(replace(PROGUY, name="N" * 30))[0] == class_b_static(replace(PROGUY, name="N" * 20))[0]
