"""HTTP: one header a file, as pure functions of values; connections and bodies with bounds."""
