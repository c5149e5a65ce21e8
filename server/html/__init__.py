"""Pages for people: every resource as HTML, drawn on the server, with forms where something can be done.

Nothing here knows a robot or a store: a `Page` (or one of its kin) goes in, bytes come out. Whatever came from a robot
is text to these pages, never markup, and `HEADERS` tells the browser to run nothing but `live.js`, which keeps a page
up to date while it is looked at, `ages.js`, which says how long ago times were, `filter.js`, which finds things on
long ones, `find.js`, which shows what is found while words are typed, `drive.js`, which drives a robot, `picture.js`,
which moves pictures, `plot.js` and `spark.js`, which draw numbers over
time, and `space.js`, which draws space from above. Without them every page is as whole.
"""
