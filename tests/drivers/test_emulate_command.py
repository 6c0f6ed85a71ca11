"""`fieldkit emulate` as a user runs it."""

import os
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from drivers.cli import emulate
from fieldkit.errors import ConfigError

RUN = "from drivers.cli import emulate\nif __name__ == '__main__':\n    emulate()\n"


@pytest.mark.parametrize("what", ["xbee", "rover", "field", "sniffer", "camera", "printer"])
def test_help_has_an_example(what):
    result = CliRunner().invoke(emulate, [what, "--help"])
    assert result.exit_code == 0
    assert f"fieldkit emulate {what}" in " ".join(result.output.split())


def test_importing_the_command_imports_nothing_heavy():
    heavy = "{'numpy', 'digi.xbee', 'pymavlink', 'serial', 'asyncio'}"
    code = f"import sys, drivers.cli; print(sorted({heavy} & set(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["field", "--rate", "0"], "rate: expected mission seconds per wall second, above 0, got 0.0"),
        (["rover", "--rate", "nan"], "above 0, got nan"),
        (["rover", "--rate", "-1"], "above 0, got -1.0"),
        (["xbee", "--rate-hz", "nan"], "--rate-hz: expected a number, got nan"),
        (["printer", "--rss-dbm", "inf"], "--rss-dbm: expected a number, got inf"),
        (["printer", "--style", "smoke"], "--style: no 'smoke'; there are: json"),
    ],
)
def test_what_cannot_be_emulated_is_refused_at_once(arguments, says):
    result = CliRunner().invoke(emulate, arguments)
    assert isinstance(result.exception, ConfigError)
    assert says in str(result.exception)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["xbee"], 'port = "'),
        (["sniffer", "--kind", "ti"], 'driver = "ti-sniffer"'),
        (["sniffer", "--kind", "pcap"], 'driver = "pcap"'),
        (["printer", "--style", "esp32-ble"], 'map = "esp32-ble"'),
        (["rover", "--address", "127.0.0.1:9"], "udpin:127.0.0.1:9"),
        (["rover", "--firmware", "copter", "--address", "127.0.0.1:19"], "copter: system_id = 1"),
        (["field", "--robots", "2", "--address", "127.0.0.1:29"], "hidden transmitter"),
    ],
)
def test_says_where_to_connect_and_ends_with_ctrl_c(tmp_path, arguments, words):
    program = tmp_path / "emulate.py"
    program.write_text(RUN)
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, str(program), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
        cwd=tmp_path,
    ) as process:
        said = ""
        for line in process.stdout:
            said += line
            if "Ctrl-C" in line:  # the last it says
                break
        process.send_signal(signal.SIGINT)
        assert process.wait(10) is not None
    assert words in said
