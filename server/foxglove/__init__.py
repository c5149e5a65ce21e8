"""`/foxglove`: a WebSocket for Foxglove, Lichtblick and PlotJuggler, in Foxglove's own protocol."""
