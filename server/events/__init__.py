"""Notification of changes: event streams, long polling, channels of the Solid Notifications Protocol.

broadcaster.py     one resource observed for all its readers
query_params.py    what a request for changes asks for
event_stream.py    the changes of a resource as an event stream (WHATWG HTML 9.2)
long_poll.py       the answer that waits for a state
motion_stream.py, sample_stream.py, space_stream.py    streams of pictures, of numbers, of a view of space
notification_channels.py, delivery.py    channels, and their notifications over HTTP or WebSocket
"""
