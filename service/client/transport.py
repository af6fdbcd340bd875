"""Requests: one place for the key, for errors, and for trying again what may be sent twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import httpx

from service.access.loopback import is_loopback
from service.client.errors import ApiError, ClientError, UnreachableError, of_response
from service.client.shapes import Page
from service.errors import OutputError
from sim.errors import reason

T = TypeVar("T")
PREFIX = "/api/v1"
PAUSE_S = 0.2
LONGEST_PAUSE_S = 5.0
WHERE = "; is it running? give its address with --url or AMBIT_URL"
Waiting = Callable[[str], None]
"""Told why a request waits to be sent again: once, at its first failed try."""


def quietly(why: str) -> None:
    """Tells nobody."""


class Patience:
    """How long, and how often, a service that is away or busy is asked again.

    Parameters
    ----------
    patience_s
        From now on, or from the last `renew`.
    waiting
        Told why, once.
    """

    def __init__(self, patience_s: float, waiting: Waiting = quietly) -> None:
        self._patience_s, self._waiting = patience_s, waiting
        self.renew()

    def renew(self) -> None:
        """Begin anew: the service has answered."""
        self._deadline = time.monotonic() + self._patience_s
        self._pause_s, self._told = PAUSE_S, False

    def wait(self, error: UnreachableError | ApiError) -> None:
        """Wait until it may be asked again.

        Raises
        ------
        UnreachableError, ApiError
            The error itself: no other try helps, or the patience is at its end.
        """
        asked_s = error.retry_after_s if isinstance(error, ApiError) else None
        if not error.passing or time.monotonic() + (asked_s or self._pause_s) > self._deadline:
            raise error
        if not self._told:
            self._told = True
            self._waiting(str(error).removesuffix(WHERE))
        self.pause(asked_s)

    def pause(self, asked_s: float | None = None) -> None:
        """Let some time pass, more each time."""
        time.sleep(asked_s or self._pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)


class Transport:
    """A connection to one service.

    Parameters
    ----------
    url
        Of the service, without ``/api/v1``.
    key
        ``ambit_...``; none for a service on this machine that has none.
    ca
        Certificate of the authority, PEM, where the system does not know it.
    timeout_s
        For an answer to begin.
    patience_s
        How long a service that is away or busy is asked again.
    waiting
        Told why, as soon as a request is to be sent again.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        ca: Path | str | None,
        timeout_s: float,
        patience_s: float,
        waiting: Waiting = quietly,
    ) -> None:
        headers = {"Accept": "application/json", "User-Agent": "ambit-client"}
        if key := (key or "").strip():  # a file's end of line
            headers["Authorization"] = f"Bearer {_sendable(key)}"
        self.url = url.rstrip("/")
        self.shows_key = bool(key)
        self.patience_s = patience_s
        self.waiting = waiting
        verify: Any = _authority(ca) if ca else True
        try:
            parts = httpx.URL(self.url)
            direct = parts.scheme == "http" and is_loopback(parts.host)  # no proxy leads to this machine
            self._http = httpx.Client(
                base_url=self.url, headers=headers, timeout=timeout_s, verify=verify, trust_env=not direct
            )
        except (httpx.InvalidURL, ValueError, OSError) as error:
            raise UnreachableError(
                f"cannot use {url!r}: {reason(error)}; give http://host:port with --url or AMBIT_URL"
            ) from error

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def get(self, path: str, **query: Any) -> Any:
        """JSON of a resource."""
        return self.send("GET", path, params=_given(query)).json()

    def content(self, path: str) -> bytes:
        """A resource as it is."""
        return self.send("GET", path, headers={"Accept": "*/*"}).content

    def post(self, path: str, body: Any = None, **query: Any) -> Any:
        """JSON of what a request made; sent again under the same Idempotency-Key when the answer was lost."""
        headers = {"Idempotency-Key": str(uuid4())}
        return self.send("POST", path, json=body, params=_given(query), headers=headers).json()

    def put(self, path: str, body: Any, of: str, tag: str, made: Callable[[Any], bool]) -> Any:
        """JSON of what a change made of a thing, if nobody else has changed it since it had this ETag.

        A change whose answer was lost is refused when it is sent again, by the ETag that it made itself: the thing is
        read, and is the answer where it is as it was to be.

        Parameters
        ----------
        of
            Path of the thing.
        made
            Whether the thing is as it was to be.
        """

        def again() -> httpx.Response | None:
            found = self.send("GET", of)
            return found if made(found.json()) else None

        return self.send("PUT", path, again, json=body, headers={"If-Match": tag}).json()

    def pages(self, path: str, shape: Callable[[Any], T], **query: Any) -> Iterator[T]:
        """Every item of a list, page by page."""
        after = None
        while True:
            page = Page[Any].model_validate(self.get(path, after=after, **query))
            yield from (shape(item) for item in page.items)
            if (after := page.next) is None:
                return

    def send(
        self, method: str, path: str, made: Callable[[], httpx.Response | None] | None = None, **how: Any
    ) -> httpx.Response:
        """A response that is no error.

        Parameters
        ----------
        made
            What a lost answer was to tell, where the request that is sent again meets 412; None for nothing.

        Raises
        ------
        UnreachableError
            Nothing answers within the patience.
        ApiError
            The service refuses.
        """
        patience = self.patience()
        lost = False
        while True:
            try:
                try:
                    response = self._http.request(method, PREFIX + path, **how)
                except (httpx.TransportError, httpx.InvalidURL) as error:
                    raise self._unreachable(error) from error
                if response.is_success or response.status_code == 304:
                    return response
                if response.status_code == 412 and lost and made is not None and (found := made()) is not None:
                    return found
                raise of_response(response)
            except (UnreachableError, ApiError) as error:
                patience.wait(error)
            lost = True  # also when a proxy says so

    def patience(self) -> Patience:
        """The patience with one request."""
        return Patience(self.patience_s, self.waiting)

    def save(self, path: str, to: Path, query: Mapping[str, Any] | None = None) -> Path:
        """A resource as a file, which appears whole or not at all; one that breaks off is fetched anew.

        Raises
        ------
        UnreachableError, ApiError
            As `send`.
        OutputError
            The file cannot be written.
        """
        temporary = to.with_name(f".{to.name}.part")
        patience = self.patience()
        try:
            to.parent.mkdir(parents=True, exist_ok=True)
            while True:
                try:
                    with self.stream(path, query=query) as response, temporary.open("wb") as file:
                        for chunk in response.iter_bytes():
                            file.write(chunk)
                    break
                except (UnreachableError, ApiError) as error:
                    patience.wait(error)
            temporary.replace(to)
        except OSError as error:
            raise OutputError(f"cannot write {to}: {error.strerror or error}; choose another folder") from error
        finally:
            temporary.unlink(missing_ok=True)
        return to

    @contextmanager
    def stream(
        self,
        path: str,
        headers: Mapping[str, str] | None = None,
        read_timeout_s: float | None = None,
        query: Mapping[str, Any] | None = None,
    ) -> Iterator[httpx.Response]:
        """A response whose body comes bit by bit; not tried again.

        Raises
        ------
        UnreachableError, ApiError
            At the first failure, also while the body is read.
        """
        timeout = httpx.Timeout(self._http.timeout.connect, read=read_timeout_s or self._http.timeout.read)
        try:
            with self._http.stream(
                "GET",
                PREFIX + path,
                headers={"Accept": "*/*"} | dict(headers or {}),
                params=_given(query or {}),
                timeout=timeout,
            ) as response:
                if not response.is_success:
                    response.read()
                    raise of_response(response)
                yield response
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise self._unreachable(error) from error

    def _unreachable(self, error: Exception) -> UnreachableError:
        found = UnreachableError(f"the service at {self.url} does not answer ({reason(error)}){WHERE}")
        found.passing = not isinstance(error, httpx.UnsupportedProtocol | httpx.InvalidURL)
        return found


def _given(query: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in query.items() if value is not None}


def _sendable(key: str) -> str:
    """A key that a header can hold; another one is not shown, as it may be most of a real one."""
    if not (key.isascii() and key.isprintable()):
        raise ClientError("the API key holds a character that no key has; give it as it was printed when it was made")
    return key


def _authority(ca: Path | str) -> Any:
    import ssl

    try:
        return ssl.create_default_context(cafile=str(ca))
    except OSError as error:  # SSLError is one
        raise UnreachableError(
            f"cannot read the authority {ca}: {reason(error)}; give a PEM file with --ca or AMBIT_CA"
        ) from error
