"""Verbs that compare with an instrument: a tracker, a scanned surface."""
