"""Changes told as they happen: event streams, and waiting for a change without one.

watches.py    how a resource tells that it may have changed
feed.py       one resource followed for all who read it
pace.py       how often a reader is told
frame.py      events as bytes (WHATWG HTML 9.2)
asked.py      what a request asks for
stream.py     the response that goes on
waiting.py    the answer that waits
"""
