"""How the tool ends: signals in imports, streams that nobody reads."""

import argparse
import os
import signal
import subprocess
import sys

import pytest

from consistent_id.cli.tool import run_to_its_end


@pytest.fixture(autouse=True)
def interrupts():
    """Hear interrupts, which a shell's background jobs ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


ENDS = [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]


@pytest.mark.parametrize(("number", "code", "word"), ENDS)
def test_a_signal_that_an_import_makes_an_error_of_is_no_bug(
    capsys, number, code, word
):
    def work(_):
        try:
            os.kill(os.getpid(), number)
        except BaseException:
            raise ImportError("numpy failed, PLEASE READ THIS") from None
        return 0

    assert run_to_its_end(argparse.Namespace(), work) == code
    assert capsys.readouterr().err == f"consistent-id: {word}\n"


def test_an_error_without_a_signal_is_a_bug_all_the_same(capsys):
    def work(_):
        raise ImportError("numpy failed")

    assert run_to_its_end(argparse.Namespace(), work) == 70
    assert "this is a bug" in capsys.readouterr().err


SIGNAL_IN_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder())
from consistent_id.cli import main
sys.exit(main(["lint", "there-is-no-such.urdf"]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("module", ["consistent_id.cli.tool", "numpy"])
@pytest.mark.parametrize(("number", "code", "word"), ENDS)
def test_a_signal_while_importing_leaves_one_line(number, code, word, module):
    text = SIGNAL_IN_IMPORT.format(module=module, number=int(number))
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert run.stderr == f"consistent-id: {word}\n"
    # Python ends itself by the signal where an import has seen it, which shells show
    # by the same code.
    assert run.returncode in (code, -int(number))


UNREAD = """
import argparse, sys
from consistent_id.cli.tool import run_to_its_end
def work(options):
    for k in range({lines}):
        print("stage", k, file=sys.stderr, flush=True)
        print("do not use", k)
    return 1
sys.exit(run_to_its_end(argparse.Namespace(), work))
"""


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 20_000])
def test_do_not_use_ends_with_1_if_nobody_reads_either_stream(lines):
    """As with ``2>&1 | head``."""
    process = subprocess.Popen(
        [sys.executable, "-c", UNREAD.format(lines=lines)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    process.stdout.close()
    assert process.wait() == 1
