"""Images in messages as JPEG and PNG, drawn in a thread and once for all readers. Independent of HTTP."""
