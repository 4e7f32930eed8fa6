"""What render.py says of options and names that there are not, and how it ends before it has begun."""

import os
import signal

import pytest
import render
from lib.held import HeldSignals

from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.command_line import error_line, run_script
from tests.support.scripts_here import call_script

# Python code: the process stops itself when it imports the module called so
STOPPED_AT = """
import builtins, os, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # where it was ignored, as in the background of a shell
real, sent = builtins.__import__, []
def stopped(name, *arguments, **options):
    if name == {name!r} and not sent:
        sent.append(os.kill(os.getpid(), signal.SIGINT))
    return real(name, *arguments, **options)
builtins.__import__ = stopped
"""


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--samples", "4"], "there is no option --samples: did you mean --set sample_count=VALUE?"),
        (["--bounces=4"], "there is no option --bounces: did you mean --set bounce_max=VALUE?"),
        (["--sett", "a=b"], "there is no option --sett: did you mean --set?"),
        (["--quite-another"], "there is no option --quite-another;"),
        (["--frame", "one"], "argument --frame: invalid int value: 'one';"),
    ],
)
def test_an_option_that_there_is_not_is_one_line_with_the_likeliest(capsys, arguments, said):
    with pytest.raises(SystemExit) as ended:
        render.main(["scene.blend", "-o", "picture.png", *arguments])
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"render.py: error: {said} --help lists all options\n"


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--set", "samples=4"], "did you mean sample_count or "),
        (["--set", "sample_count=1.5"], "it must be a whole number, 1 to "),
        (["--passes", "Dept"], "there is no pass 'Dept'; did you mean Depth"),
        (["--passes", "CryptoObject"], "did you mean CryptoObject00 or CryptoObject01"),
        (["--passes", "nothing like it"], "there is no pass 'nothing like it'; the passes are "),
        (["--frames", "1-3"], "is not a range A..B of whole numbers, such as 1..24"),
    ],
)
def test_a_name_or_value_that_there_is_not_says_what_may_be_meant(tmp_path, arguments, said):
    done = run_script("render.py", tmp_path / "scene.blend", "-o", tmp_path / "x.png", *arguments)
    assert done.returncode == 1 and said in error_line(done)


def test_an_empty_device_is_none(tmp_path):
    path = tmp_path / "scene.scene.npz"
    save_scene(path, scenes.mixed(scenes.Frame(6, 4)), RenderSettings())
    for arguments in ([path, "-o", tmp_path / "x.png"], ["--prewarm"]):
        done = call_script("render.py", *arguments, "--device", "")
        assert done.returncode == 1
        assert done.stderr.startswith("render.py: error: there is no device '': choose one of AUTO, cpu")


@pytest.fixture
def handler():
    """Of Ctrl-C for the time of the test, whatever it is outside."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield signal.default_int_handler
    signal.signal(signal.SIGINT, before)


def test_signals_are_held_until_they_are_released(handler):
    went_on = []
    with pytest.raises(KeyboardInterrupt), HeldSignals():
        os.kill(os.getpid(), signal.SIGINT)
        went_on.append(True)
    assert went_on and signal.getsignal(signal.SIGINT) is handler


def test_signals_that_are_ignored_stay_so(handler):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with HeldSignals():
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize("name", ["numpy", "bpy"])
def test_a_stop_in_mid_import_ends_as_any_other(tmp_path, name):
    blend = tmp_path / "empty.blend"
    blend.write_bytes(b"")
    done = run_script("render.py", blend, "-o", tmp_path / "x.png", before=STOPPED_AT.format(name=name))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "render.py: stopped\n")
