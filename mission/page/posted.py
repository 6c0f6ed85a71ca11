"""What a browser posts, as plain values: no more than is sensible, and nothing in it that could not be written."""

import json
from typing import Any

from starlette.requests import Request

from fieldkit.errors import DataError, os_words


async def posted(request: Request, *, most_bytes: int) -> Any:
    """What was posted. Raises `DataError`: too much, no JSON, or with numbers and letters that are none."""
    body = b""
    async for block in request.stream():
        body += block
        if len(body) > most_bytes:
            raise DataError(f"expected {most_bytes} bytes at the most")
    try:
        plain = json.loads(body)
        # What cannot be written as JSON again would be met later, in a file or in an answer.
        json.dumps(plain, allow_nan=False, ensure_ascii=False).encode()
    except UnicodeError:
        raise DataError("expected text, got half a letter") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"cannot be read: {os_words(error)}") from None
    return plain
