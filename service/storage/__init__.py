"""What the service keeps: tables on SQLite or PostgreSQL, and files by their SHA-256."""
