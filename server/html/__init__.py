"""HTML pages for people: every resource, rendered on the server, with forms for its operations.

This package knows no robot and no store: it turns a `Page` (or a similar value) into bytes. Text from a robot is always
escaped, never markup, and `HEADERS` let the browser run only scripts from this server: `live.js` keeps an open page up
to date, `ages.js` shows how long ago times were, `filter.js` filters long pages, `find.js` searches while the user
types, `drive.js` drives a robot, `picture.js` streams pictures, `plot.js` and `spark.js` draw numbers over time, and
`space.js` draws space from above. Every page is complete without scripts.
"""
