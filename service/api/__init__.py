"""The API: resources over HTTP, problems as RFC 9457 says, and the description of it all in OpenAPI."""
