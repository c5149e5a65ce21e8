"""Notification of changes: event streams, long polling, channels of the Solid Notifications Protocol.

broadcaster.py     observation of a resource, shared by all its readers
query_params.py    query parameters of requests for changes
event_stream.py    changes of a resource as an event stream (WHATWG HTML 9.2)
long_poll.py       requests that wait for a change or a condition
sample_stream.py, space_stream.py    streams of numbers, and of a view of space
notification_channels.py, delivery.py    channels, and their notifications over HTTP or WebSocket
"""
