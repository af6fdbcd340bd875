"""Backup and restore of the service: both databases and the store.

A backup is a folder named by its time, beside a folder ``store`` that all backups share, because files there are named
by their content and never change: a backup every night costs what the day added.
"""
