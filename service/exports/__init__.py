"""Models and frequency responses in the formats of other tools, and back. Conversion is pure; `files` does I/O."""
