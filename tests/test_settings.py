"""Settings: flags over environment over file over defaults, each with its source."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomend.errors import InputError
from robomend.programs import Unfit, arguments, check_template
from robomend.settings import Settings, SettingsError, load, shown


def test_flags_win_over_environment_over_file_over_defaults(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("port: 1\nburst: 2\nlog_level: debug\n")
    environment = {"ROBOMEND_PORT": "3", "ROBOMEND_BURST": "4", "ROBOMEND_WEBHOOK_HOSTS": "a:80,b"}
    settings, sources = load({"port": 5, "host": None}, environment, file)
    assert (settings.port, settings.burst, settings.log_level) == (5, 4, "debug")
    assert settings.webhook_hosts == ("a:80", "b")
    assert sources["port"] == "flag"
    assert sources["burst"] == "environment ROBOMEND_BURST"
    assert sources["log_level"] == str(file)
    assert sources["host"] == "default"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("prot: 1", "prot"),
        ("port: -1", "port"),
        ("[1]", "mapping"),
        ("a: [", "YAML"),
        ("max_nesting: 3", "max_nesting"),
        ("robomend: 1\nname: m", "this is a model, and settings"),
    ],
)
def test_what_is_wrong_is_said_with_its_source(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load({}, {}, file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        load({}, {}, tmp_path / "none.yaml")


def test_an_empty_file_sets_nothing(tmp_path: Path) -> None:
    file = tmp_path / "s.yaml"
    file.write_text("# nothing\n")
    assert set(load({}, {}, file)[1].values()) == {"default"}


def test_lists_come_from_the_environment_by_commas() -> None:
    settings, _ = load({}, {"ROBOMEND_ALLOWED_HOSTS": "a.lan,b.lan"}, None)
    assert settings.allowed_hosts == ("a.lan", "b.lan")


def test_a_password_is_not_shown() -> None:
    settings = Settings.model_validate({"database": "postgresql://u:secret@h/d"})
    assert "secret" not in str(shown(settings))
    assert "secret" not in repr(settings)


# --- argument lists: what a plan's names may become, and what not


def test_each_value_is_one_argument_or_a_part_of_one() -> None:
    template = ("usbreset", "--bus={0}", "{1}")
    assert arguments(template, ("a; reboot $(x)", "b c")) == ["usbreset", "--bus=a; reboot $(x)", "b c"]


@pytest.mark.parametrize(
    "value", ["--exec=sh", "-rf", "-", "../../etc/passwd", "/etc/passwd", "a/b", "a\\b", ".", "..", "a\0b"]
)
@pytest.mark.parametrize("part", ["{0}", "--bus={0}"])
def test_an_option_or_a_path_is_no_value_of_a_plain_place(value: str, part: str) -> None:
    with pytest.raises(Unfit, match="takes no"):
        arguments(("run", part), (value,))


def test_a_place_for_paths_takes_paths_and_no_options() -> None:
    assert arguments(("run", "{0:path}"), ("../a/b",)) == ["run", "../a/b"]
    with pytest.raises(Unfit, match="option"):
        arguments(("run", "{0:path}"), ("-rf",))


def test_behind_two_dashes_a_place_may_take_anything() -> None:
    template = ("run", "-v", "--", "{0:any}")
    check_template(template)
    assert arguments(template, ("--exec=sh",)) == ["run", "-v", "--", "--exec=sh"]


def test_too_few_parameters_are_told() -> None:
    with pytest.raises(Unfit, match="wants more than 1"):
        arguments(("run", "{1}"), ("a",))


@pytest.mark.parametrize(
    ("template", "said"),
    [
        ((), "names no program"),
        (("",), "names no program"),
        (("{0}", "-v"), "must not depend"),
        (("/opt/{0}/run",), "must not depend"),
        (("run", "{0:any}", "--"), "behind `--` only"),
        (("run", "{0:file}"), "a place is"),
    ],
)
def test_a_template_that_leaves_too_much_to_a_plan_is_refused(template: tuple[str, ...], said: str) -> None:
    with pytest.raises(Unfit, match=said):
        check_template(template)


def test_the_settings_refuse_such_a_template_and_say_whose_it_is() -> None:
    with pytest.raises(SettingsError, match=r"program 'reset': .*must not depend"):
        load({"programs": {"reset": ["{0}"]}}, {}, None)
    assert load({"programs": {"reset": ["r", "{0}"]}}, {}, None)[0].programs == {"reset": ("r", "{0}")}
