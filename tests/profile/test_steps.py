"""Steps of a card: what is read, and what is refused with the key and how to mend it."""

import pytest

from station.profile import Card, from_json, load_card, profiles_dir, to_json
from station.rows import ProfileError

GUIDED = (profiles_dir() / "cards" / "guided.toml").read_text()


def test_shares_are_percent_or_numbers_and_lateral_inputs_ask_for_lateral_derivatives() -> None:
    card = load_card("guided").card
    assert card.steps[0].accept == {"CL_alpha": 0.1, "Cm_alpha": 0.2, "Cm_q": 0.15}
    assert card.asks_lateral
    assert not card.manoeuvres
    doublet = {"kind": "doublet", "start": "0 s", "amplitude": "2 deg", "width": "1 s"}
    steps = [{"name": "a", "inputs": [doublet], "accept": {"Cm_q": 0.2}}]
    made = Card.model_validate({"name": "x", "aircraft": "", "rig": "", "steps": steps})
    assert made.steps[0].accept == {"Cm_q": 0.2}
    assert not made.asks_lateral


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('CL_alpha = "10 %"', 'CL_alfa = "10 %"', "unknown derivative CL_alfa; did you mean CL_alpha?"),
        ('CL_alpha = "10 %"', 'CL_alpha = "10 deg"', 'write "3 %" or 0.03'),
        ('CL_alpha = "10 %"', "CL_alpha = 10", "less than or equal to 1"),
        ('name = "Short period, 110 kt"', 'title = "x"', "unknown key"),
        ('air = "light"', 'air = "smooth"', "unknown: smooth"),
        ('speed_tolerance = "5 kt"', 'speed_tolerance = "5"', "missing unit"),
        ('start = "0 s"', 'start = "0 s"\nrepeat = "9 s"', "a step has repeats"),
        ("load_factor = 2.0", "load_factor = 0.5", "greater than 1"),
        ("[limits]", "[limits]\nbanking = 3", "unknown key"),
        ('least_speed = "80 kt"', 'least_speed = "150 kt"', "speed: 150 kt is not above least_speed, 150 kt"),
        ('speed = "150 kt"', 'speed = "110 kt"', "condition.speed of 110 kt, not below limits.speed, 110 kt: change"),
        ('least_speed = "80 kt"', 'least_speed = "120 kt"', "condition.speed of 110 kt, not above limits.least_speed"),
        ("[steps.condition]", '[steps.condition]\nbank = "-50 deg"', "condition.bank of 50 deg, not below limits.bank"),
        ('name = "Roll and yaw, 110 kt"', 'name = "Short period, 110 kt"', "two are named 'Short period, 110 kt'"),
    ],
)
def test_a_mistake_names_its_key(tmp_path, old: str, new: str, words: str) -> None:
    assert old in GUIDED
    path = tmp_path / "mine.toml"
    path.write_text(GUIDED.replace(old, new, 1))
    with pytest.raises(ProfileError, match=r"mine\.toml: ") as told:
        load_card(str(path))
    assert words in str(told.value)


def test_a_step_without_an_input_is_none(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GUIDED.partition("[[steps.inputs]]")[0])
    with pytest.raises(ProfileError, match="what is to be flown"):
        load_card(str(path))


def test_a_turn_takes_its_load_factor() -> None:
    """1/cos 62 deg = 2.13, above 2; 1/cos 58 deg = 1.89, below."""
    doublet = {"kind": "doublet", "start": "0 s", "amplitude": "2 deg", "width": "1 s"}

    def made(bank: str) -> Card:
        steps = [{"name": "a", "inputs": [doublet], "condition": {"bank": bank}}]
        limits = {"load_factor": 2.0, "bank": "80 deg"}
        return Card.model_validate({"name": "x", "aircraft": "", "rig": "", "steps": steps, "limits": limits})

    made("58 deg")
    with pytest.raises(ValueError, match=r"62 deg takes a load factor of 2\.13, not below limits\.load_factor, 2:"):
        made("62 deg")


def test_a_card_that_was_flown_is_read_as_it_was() -> None:
    """Recordings of before keep cards that would be refused now."""
    old = to_json(load_card("guided").card).replace("Roll and yaw, 110 kt", "Short period, 110 kt")
    old = old.replace('"least_speed":41.15', '"least_speed":99.15')
    card = from_json(Card, old)
    assert len({s.name for s in card.steps}) < len(card.steps)
    assert card.limits.least_speed > card.limits.speed
