"""Modbus TCP, TLS and RTU: register map, codec, driver."""
