"""The `fieldkit` command: every subcommand is found by entry point, so that a user's package can add one."""

import logging
import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from fieldkit import __version__, console, plugins
from fieldkit.errors import ConfigError, FieldkitError
from fieldkit.interrupts import keep_interrupts

HELP = """Find unknown, short-lived radio transmitters with a team of small robots.

Start with 'fieldkit demo': one whole mission on emulated radios and rovers.
"""
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
"""Read by numpy's linear algebra when it is loaded. Our matrices are small: more threads wait for each other, beside
another busy process for most of the time, and how many there are may change the last bit of a result."""


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fieldkit {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Log what drivers and the runner do.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Say nothing but results and trouble.")
    ] = False,
) -> None:
    console.be_quiet(quiet)
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING if quiet else console.NEWS,
        format=f"%(asctime)s %(levelname)s{' %(name)s' if verbose else ''}: %(message)s",
        datefmt=None if verbose else "%H:%M:%S",
        handlers=[console.StderrHandler()],
    )


def build() -> typer.Typer:
    """The command tree: a `typer.Typer` under an entry point becomes a group, a function a command."""
    app = typer.Typer(
        help=HELP,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_root)
    for name in plugins.names("fieldkit.commands"):
        try:
            _add(app, name, plugins.load("fieldkit.commands", name))
        except ConfigError as error:  # one broken package must not take the others' commands away
            _add(app, name, _broken(str(error)))
    return app


def _add(app: typer.Typer, name: str, thing: Any) -> None:
    if isinstance(thing, typer.Typer):
        app.add_typer(thing, name=name)
    else:
        app.command(name)(thing)


def _broken(message: str) -> Callable[[], None]:
    """A command that says why it cannot be had."""

    def explain() -> None:
        raise ConfigError(message)

    explain.__doc__ = "Not available: its package cannot be imported."
    return explain


def main() -> None:
    """Run the command line; errors made on purpose are printed plainly, with their exit code."""
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    keep_interrupts()
    try:
        build()()
    except FieldkitError as error:
        typer.echo(f"fieldkit: {error}", err=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        typer.echo("fieldkit: interrupted", err=True)
        sys.exit(130)
    except BrokenPipeError:  # whoever read our output has enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except OSError as error:
        named = f"{error.filename}: " if error.filename else ""
        typer.echo(f"fieldkit: {named}{error.strerror or error}", err=True)
        sys.exit(2)
    except Exception as error:
        typer.echo(f"fieldkit: {_unforeseen(error)}", err=True)
        sys.exit(70)


def _unforeseen(error: Exception) -> str:
    """What a person reads of an error of ours; whoever can mend it finds the rest in a file."""
    import tempfile
    import traceback

    said = f"an error of fieldkit's own: {type(error).__name__}: {error}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="fieldkit-error-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(
                f"fieldkit {__version__}, {sys.version}\n{' '.join(sys.argv)}\n\n{traceback.format_exc()}"
            )
    except OSError:
        return f"{said}\n{traceback.format_exc()}"
    return f"{said}; please report it with {file.name}"
