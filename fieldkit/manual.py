"""`fieldkit docs`: the manual that travels in the wheel, served on this computer alone, without internet."""

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldkit.errors import ConfigError

if TYPE_CHECKING:
    from http.server import ThreadingHTTPServer


def manual_folder() -> Path:
    """Where the manual lies. Raises `ConfigError` for an installation that was built without it."""
    folder = Path(str(resources.files("fieldkit"))) / "_manual"
    if not (folder / "index.html").is_file():
        raise ConfigError(
            f"{folder}: this installation carries no manual; in a checkout 'make docs' builds it, "
            "and docs/*.md are readable as they are"
        )
    return folder


def server(port: int = 0) -> "ThreadingHTTPServer":
    """A server of the manual on the loopback interface; `server_port` says where. Not yet serving."""
    from functools import partial
    from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            """Nothing: who reads does not watch the terminal."""

    return ThreadingHTTPServer(("127.0.0.1", port), partial(Quiet, directory=str(manual_folder())))


def docs(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve on; 0: any that is free.")] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address, open no browser.")
    ] = False,
    path: Annotated[bool, typer.Option("--path", help="Print where the manual lies and exit.")] = False,
) -> None:
    """Open the manual in the browser. It needs no internet; Ctrl-C ends it.

    Example: fieldkit docs
    """
    import webbrowser

    if path:
        typer.echo(manual_folder() / "index.html")
        return
    with server(port) as serving:
        address = f"http://127.0.0.1:{serving.server_port}/index.html"
        typer.echo(f"the manual is at {address}; Ctrl-C ends it")
        if not no_browser:
            webbrowser.open(address)
        serving.serve_forever()
