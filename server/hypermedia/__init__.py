"""The paper's levels two and three: resources by convention, arranged by mappings, offered by their state."""
