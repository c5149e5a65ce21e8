"""Pictures: messages of images drawn as JPEG and PNG, off the event loop and once for all readers. No HTTP."""
