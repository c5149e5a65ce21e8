"""Notification of changes: event streams, long polling, channels of the Solid Notifications Protocol.

watches.py    how a resource tells that it may have changed
feed.py       one resource followed for all who read it
pace.py       how often a reader is told
frame.py      events as bytes (WHATWG HTML 9.2)
asked.py      what a request asks for
stream.py     the response that goes on
waiting.py    the answer that waits
"""
