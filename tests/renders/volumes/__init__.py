"""Renders of volumes: closed forms, and what schedules must not change."""
