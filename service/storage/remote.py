"""Where files are kept: a folder, or a store behind an fsspec URL, and what its errors mean to whoever runs it.

Credentials are never in a URL, which logs and messages show: s3fs takes them where boto does, from
``AWS_ACCESS_KEY_ID`` and ``AWS_SECRET_ACCESS_KEY``, a profile, or the machine's role.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qsl

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from service.errors import StorageError
from sim.errors import reason

_OF_S3 = {"endpoint_url": "endpoint_url", "profile": "profile"}
_CLIENT_OF_S3 = {"region": "region_name"}
CONNECT_S, READ_S = 3.0, 60.0
_REMEDIES = {
    "NoCredentialsError": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE",
    "PermissionError": "check the credentials, and that they may list, read, write and delete there",
    "FileNotFoundError": "make the bucket, or correct store_url",
}
_AWAY = "see that the server runs, and check store_url and AWS_ENDPOINT_URL"


def opened(url: str) -> tuple[Any, str, bool]:
    """File system and root of a store, and whether it is a folder of this machine.

    Parameters
    ----------
    url
        Folder or fsspec URL. One of ``s3://`` may end with ``?endpoint_url=https://...``, ``region=`` and ``profile=``.

    Raises
    ------
    StorageError
        The URL is unknown, or its library is not installed.
    """
    options: dict[str, Any] = {}
    plain = url
    if url.startswith("s3:"):
        plain, _, query = url.partition("?")
        options = _s3_options(url, query)
    try:
        fs, root = url_to_fs(plain, **options)
    except (ValueError, ImportError) as error:
        remedy = "; pip install 'amb-commissioning[s3]'" if url.startswith("s3:") else ""
        raise StorageError(f"cannot use the store {url}: {error}{remedy}") from error
    return fs, root, isinstance(fs, LocalFileSystem)


def _s3_options(url: str, query: str) -> dict[str, Any]:
    asked = dict(parse_qsl(query, keep_blank_values=True))
    if wrong := sorted(set(asked) - set(_OF_S3) - set(_CLIENT_OF_S3)):
        known = ", ".join([*_OF_S3, *_CLIENT_OF_S3])
        raise StorageError(f"cannot use the store {url.partition('?')[0]}: no option {wrong[0]!r}; there are {known}")
    client = {_CLIENT_OF_S3[k]: v for k, v in asked.items() if k in _CLIENT_OF_S3}
    # s3fs itself tries five times: with botocore's tries on top a server that is away costs 20 s
    tries = {"connect_timeout": CONNECT_S, "read_timeout": READ_S, "retries": {"total_max_attempts": 1}}
    return {
        **{_OF_S3[k]: v for k, v in asked.items() if k in _OF_S3},
        "client_kwargs": client,
        "config_kwargs": tries,
        "use_listings_cache": False,  # other machines put and remove files too
    }


@contextmanager
def answering(doing: str, local: bool) -> Iterator[None]:
    """Whatever a store raises, but for a file that is not there, is a `StorageError` with a remedy.

    Parameters
    ----------
    doing
        For the message: "read from".
    """
    try:
        yield
    except (StorageError, FileNotFoundError):
        raise
    except Exception as error:
        if local and not isinstance(error, OSError):
            raise
        remedy = "free space, or check its address" if local else _remedy(error)
        raise StorageError(f"cannot {doing} the store: {told(error)}; {remedy}") from error


def told(error: Exception) -> str:
    """An error in one line."""
    return reason(error).rstrip(".")


def _remedy(error: Exception) -> str:
    return next((_REMEDIES[t.__name__] for t in type(error).__mro__ if t.__name__ in _REMEDIES), _AWAY)
