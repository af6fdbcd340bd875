"""The commissioning result: figures with their uncertainty, how they were checked, written and read back."""
