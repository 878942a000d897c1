"""The component model's loader: everything wrong is refused with its line and with what is allowed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.examples import examples

from robomend.errors import ModelError
from robomend.model.loading import load_model, load_text
from robomend.resources import resource
from robomend_client.literals import Atom
from robomend_client.yaml_tree import MAX_NESTING

FULL = """\
robomend: 1
name: full
channels: 12
protected_channels: [2]
hardware:
  pc: {channel: 2}
  psu: {}
  base: {channel: 11, fed_by: [psu], cost: 2.5, prior: 0.01, host: pc1, protected: true}
  arm:
    channel: 0
    modes: {stuck: ["not ok(joints)"], slow: []}
    exhaustive_modes: true
  imu: {blame_hardware: true}
nodes:
  /driver: {drives: [base, imu], publishes: {/odom: [/cmd]}, inputs_matter: true, restartable: false}
  planner: {publishes: {cmd: [odom], plan: []}, tied_to: [driver], host: pc2, prior: 0.1, cost: 3}
  on: {drives: arm, publishes: [joints]}
topics:
  odom: {rate_hz: 20, tolerance_hz: 2, cost: 0.5}
  clock: {}
properties: {temp: {cost: 4}, load: {}}
values: {yaw: {topic: odom, field: a.b}, turn: {topic: cmd, field: z}}
related: [[yaw, turn]]
rules: ["not ok(temp) -> ab(planner)"]
"""


def test_reads_everything_that_the_format_has() -> None:
    system = load_text(FULL)
    model = system.parts
    assert model is not None
    assert (model.name, model.channels, model.protected_channels) == ("full", 12, (2,))
    assert model.hardware["pc"].protected  # by its channel
    base = model.hardware["base"]
    assert (base.channel, base.fed_by, base.cost, base.prior) == (11, ("psu",), 2.5, 0.01)
    assert (base.host, base.protected) == ("pc1", True)
    arm = model.hardware["arm"]
    assert (dict(arm.modes), arm.exhaustive_modes) == ({"stuck": ("not ok(joints)",), "slow": ()}, True)
    assert model.hardware["imu"].blame
    driver = model.nodes["driver"]
    assert (driver.drives, dict(driver.publishes)) == (("base", "imu"), {"odom": ("cmd",)})
    assert (driver.inputs_matter, driver.restartable) == (True, False)
    planner = model.nodes["planner"]
    assert (planner.tied_to, planner.host, planner.prior, planner.cost) == (("driver",), "pc2", 0.1, 3)
    assert model.nodes["on"].drives == ("arm",)  # `on` is a name here, not YAML's true
    assert model.topics["odom"].rate_hz == 20
    assert model.properties == ("temp", "load")
    assert system.cnf.costs == {Atom("ok", ("odom",)): 0.5, Atom("ok", ("temp",)): 4}
    assert system.cnf.priors == {"base": 0.01, "planner": 0.1}
    assert not system.cnf.weak
    assert system.source == FULL


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("channel: 11", "channel: 12", 8, "whole number from 0 to 11"),
        ("channel: 11", "channel: 11, boot_s: -1", 8, "seconds from 0 to 3600, not `-1`"),
        ("channel: 11", "channel: 11, start_s: 3", 8, "hardware base has no key `start_s`"),
        ("drives: arm", "drives: arm, start_s: nan", 17, "seconds from 0 to 3600, not `nan`"),
        ("channel: 11", "channel: x", 8, "whole number from 0 to 11"),
        ("channel: 11", "channel: 0", 9, r"channel 0 is used twice \(base, arm\)"),
        (
            "channel: 11",
            "chanel: 11",
            8,
            "did you mean `channel`.*allowed are channel, fed_by",
        ),
        ("psu: {}", "psu: {fed_by: [base]}", 7, "round in a circle: psu fed by base fed by psu"),
        ("[psu]", "[pssu]", 8, "no hardware is named `pssu`; did you mean `psu`"),
        (", inputs_matter: true", "", 15, "say `inputs_matter: true`, or drop them"),
        ("cmd: [odom]", "cmd: [odm]", 16, "reads `odm`, which no node publishes; did you mean `odom`"),
        ("tied_to: [driver]", "tied_to: [diver]", 16, "no node is named `diver`"),
        ("tied_to: [driver]", "tied_to: [planner]", 16, "tied to itself"),
        ("prior: 0.1,", "prior: 1,", 16, "between 0 and 1, both excluded"),
        ("prior: 0.1,", "prior: nan,", 16, "between 0 and 1, both excluded"),
        ("cost: 3", "cost: 0", 16, "number above 0"),
        ("host: pc2", "host: [pc2]", 16, "expected a name, not a list"),
        ("planner:", "base:", 16, "`base` is hardware already"),
        ("planner:", "driver:", 16, r"`driver` is written twice \(first in line 15\)"),
        ("rate_hz: 20", "rate_hz: fast", 19, "number above 0, not `fast`"),
        ("load: {}", "odom: {}", 21, "`odom` is a topic already"),
        ("topic: cmd, field: z", "topic: cmd", 22, "value turn needs `field:`"),
        ("topic: cmd,", "topic: cmds,", 22, "did you mean `cmd`"),
        ("values: {yaw: ", "values:\n  {yaw: {topic: oddom, field: c}, twist:\n ", 23, "did you mean `odom`"),
        ("[[yaw, turn]]", "[[yaw, yaw]]", 23, "twice"),
        ("[[yaw, turn]]", "[[yaw]]", 23, "two different values"),
        ("[[yaw, turn]]", "[[yaw, tern]]", 23, "did you mean `turn`"),
        ("ab(planner)", "ab(planer)", 24, "did you mean 'planner'"),
        ("not ok(temp) ->", "not ok(temp -> ", 24, "rule 1: .*position 12"),
        ("not ok(temp)", "not on(temp)", 24, "no hardware is named temp"),
        ("stuck: [", "unknown: [", 11, "is there by itself"),
        ("exhaustive_modes: true", "exhaustive_modes: maybe", 12, "true or false"),
        ("robomend: 1", "robomend: 2", 1, "`robomend: 1` is the only format"),
        ("name: full", "nmae: full", 2, "did you mean `name`"),
        ("channels: 12", "channels: 12\nchannels: 12", 4, "written twice"),
        ("channels: 12", "channels: 0", 3, "whole number from 1 to 255"),
        ("clock: {}", "clock: 5", 20, "topic clock is a mapping"),
        ("clock: {}", "'': {}", 20, "a name is empty"),
        ("clock: {}", '"a\\nb": {}', 20, "control character"),
        ("clock: {}", f"{'x' * 300}: {{}}", 20, "at most 200"),
    ],
)
def test_mistakes_are_named_with_line_and_remedy(old: str, new: str, line: int, message: str) -> None:
    assert old in FULL
    with pytest.raises(ModelError, match=message) as caught:
        load_text(FULL.replace(old, new, 1), file="robot.yaml")
    assert (caught.value.file, caught.value.line) == ("robot.yaml", line)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("just text", "no model"),
        ("a: 1", "a component model begins with `robomend: 1`"),
        ("robomend: 1", "no component"),
        ("robomend: 1\nhardware: [a]\nnodes: [", "not YAML"),
        ("robomend: 1\nhardware: &x {a: {}}\nnodes: *x", "aliases are not read"),
        ("robomend: 1\n---\nrobomend: 1", "second document"),
        ("robomend: 1\n? [a]\n: b", "a key must be a name"),
        ("robomend: 1\nhardware: " + "[" * (MAX_NESTING + 5), "nested deeper"),
        ("a: " + "{a: " * 100_000, "nested deeper"),
        ("robomend: 1\nhardware: [a, a]", "twice"),
        ("robomend: 1\nhardware: {a: {}, /a: {}}", "written twice"),
        ("\x00", "not YAML"),
    ],
)
def test_what_is_no_model_is_refused(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_text(text)


def test_an_alias_bomb_is_refused_at_its_first_alias() -> None:
    bomb = "robomend: 1\na0: &a0 [x, x]\n" + "".join(
        f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60)
    )
    with pytest.raises(ModelError, match="aliases") as caught:
        load_text(bomb)
    assert caught.value.line == 3


def test_files_that_cannot_be_read_are_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("models")
    with pytest.raises(ModelError, match="No such file"):
        load_model(folder / "none.yaml")
    with pytest.raises(ModelError, match="cannot be read"):
        load_model(folder)
    (folder / "latin.yaml").write_bytes(b"robomend: 1\nname: \xe9")
    with pytest.raises(ModelError, match=r"latin.yaml:2: not UTF-8"):
        load_model(folder / "latin.yaml")
    (folder / "blank.yaml").write_bytes(b"\n\n\xe9")
    with pytest.raises(ModelError, match=r"blank.yaml:3: not UTF-8"):
        load_model(folder / "blank.yaml")
    (folder / "bom.yaml").write_bytes(b"\xef\xbb\xbfrobomend: 1\nnodes: [a]")
    assert load_model(folder / "bom.yaml").name == "bom"


@pytest.mark.parametrize("character", ["\0", "\x07", "\x7f", "\ufffe"])
def test_a_character_that_yaml_never_takes_is_refused_with_its_line(character: str) -> None:
    with pytest.raises(ModelError, match=r"not YAML: character #x[0-9a-f]+ is not allowed") as caught:
        load_text(f"robomend: 1\nname: a\u00e9\U0001f916\nnodes: [a{character}]\n")
    assert caught.value.line == 3


@given(st.text(alphabet="robmend: 1\nhawcl{}[],&*!|>-'\"#?%@\t0x", max_size=80) | st.text(max_size=40))
@examples(300)
def test_garbage_raises_model_errors_only(text: str) -> None:
    for whole in (text, "robomend: 1\nnodes:\n  a: {}\n" + text):
        try:
            load_text(whole)
        except ModelError as error:
            str(error)


@given(st.integers(0, len(FULL) - 1), st.integers(0, 12), st.text(alphabet="{}[]:,-\n &*a1'\"", max_size=4))
@examples(300)
def test_a_damaged_model_raises_model_errors_only(at: int, cut: int, put: str) -> None:
    try:
        load_text(FULL[:at] + put + FULL[at + cut :])
    except ModelError as error:
        str(error)


@given(st.integers(0, 2000), st.integers(0, 12), st.text(alphabet="()->,\"' not_ab", max_size=4))
@examples(200)
def test_a_damaged_five_key_file_raises_model_errors_only(at: int, cut: int, put: str) -> None:
    text = "ab: AB\nnab: NAB\nneg_prefix: not_\nprops: [p, 'q(a)']\nrules: ['NAB(x),p->q(a)', 'not_p->AB(x)']"
    at %= len(text)
    try:
        load_text(text[:at] + put + text[at + cut :])
    except ModelError as error:
        str(error)


@pytest.mark.parametrize("example", ["tedusar.yaml", "tedusar_spare.yaml", "mobile_manipulator.yaml"])
def test_the_examples_load_without_a_warning(example: str) -> None:
    assert load_model(resource("examples", example)).warnings == ()
