"""Who may do what: keys, rate, and the words of the audit log. Pure: no database, no network."""
