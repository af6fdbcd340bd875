"""Errors of the client.

::

    ServiceError (service.errors)
    └── ClientError
        ├── UnreachableError     nothing answers there, or the answer broke off
        ├── JobEndedError        a job that was waited for failed or was cancelled; carries the job
        ├── JobGoesOnError       a job that should be done waits or runs; carries the job
        └── ApiError             the service refuses; carries status, detail and fields as the problem says (RFC 9457)
            ├── KeyRefusedError     401, 403
            ├── MissingError        404
            ├── ConflictingError    409, 412, 428
            └── RefusedError        400, 413, 415, 422: what was sent is not accepted
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import httpx

from service.errors import ServiceError

if TYPE_CHECKING:
    from service.client.shapes import Job


BUSY = (429, 502, 503, 504)


class ClientError(ServiceError):
    """Base of every error of the client."""


class UnreachableError(ClientError):
    """Nothing answers at the address.

    Attributes
    ----------
    passing
        Whether another try may help.
    """

    passing = True


class JobEndedError(ClientError):
    """A job ended without its result.

    Attributes
    ----------
    job
        As it ended.
    """

    def __init__(self, message: str, job: Job) -> None:
        super().__init__(message)
        self.job = job


class JobGoesOnError(ClientError):
    """A job has no whole result yet.

    Attributes
    ----------
    job
        As it was.
    """

    def __init__(self, message: str, job: Job) -> None:
        super().__init__(message)
        self.job = job


class ApiError(ClientError):
    """The service refuses a request.

    Attributes
    ----------
    status
        Of HTTP.
    detail
        One line that names the thing and the remedy.
    errors
        Fields of the request that are wrong: ``field`` and ``reason``.
    request_id
        Under which the service's log tells more.
    passing
        Whether another try may help: the service is busy, or away behind a proxy.
    retry_after_s
        How long it asks to be left alone; None where it does not say.
    """

    retry_after_s: float | None = None

    def __init__(self, status: int, detail: str, errors: list[dict[str, Any]], request_id: str) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.errors = errors
        self.request_id = request_id
        self.passing = status in BUSY


class KeyRefusedError(ApiError):
    """There is no key, or it does not reach so far."""


class MissingError(ApiError):
    """There is no such thing."""


class ConflictingError(ApiError):
    """The state of the thing does not allow it."""


class RefusedError(ApiError):
    """What was sent is not accepted."""


_KINDS: dict[int, type[ApiError]] = {
    400: RefusedError,
    401: KeyRefusedError,
    403: KeyRefusedError,
    404: MissingError,
    409: ConflictingError,
    412: ConflictingError,
    413: RefusedError,
    415: RefusedError,
    422: RefusedError,
    428: ConflictingError,
}


def of_response(response: httpx.Response) -> ApiError:
    """The error that a response is. Its body must have been read."""
    try:
        body = response.json()
    except ValueError:
        body = None
    if not isinstance(body, dict):
        body = {}
    detail = str(body.get("detail") or body.get("title") or f"the service answers {response.status_code}")
    request_id = str(body.get("request_id") or response.headers.get("x-request-id", ""))
    errors = [e for e in body.get("errors") or [] if isinstance(e, dict)]
    kind = _KINDS.get(response.status_code, ApiError)
    if kind is ApiError and request_id:
        detail = f"{detail} (request {request_id})"
    error = kind(response.status_code, detail, errors, request_id)
    told = response.headers.get("retry-after", "")
    error.retry_after_s = float(told) if told.isascii() and told.isdigit() else None
    return error
