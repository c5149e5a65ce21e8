"""Resources: one file a kind of URL, thin: parse a request, ask the services below, describe the outcome."""
