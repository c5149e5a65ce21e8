import org.apache.jena.atlas.web.HttpException;
import org.apache.jena.rdf.model.ResourceFactory;
import org.apache.jena.rdfconnection.RDFConnection;
import org.apache.jena.sparql.exec.http.UpdateExecutionHTTP;
import org.apache.jena.sparql.exec.http.UpdateSendMode;
import org.apache.jena.system.Txn;
import org.apache.jena.update.UpdateFactory;

/** Jena's RDFConnection: updates. Each check has graphs of its own. */
final class JenaUpdate {
    private final String url;
    private int counter;

    private JenaUpdate(String url) {
        this.url = url;
    }

    static void run(String url) {
        new JenaUpdate(url).run(new Checks("JenaUpdate"));
    }

    private RDFConnection connection() {
        return JenaQuery.connection(url);
    }

    private String fresh() {
        return url + "data/jena/updated" + ++counter;
    }

    private static String insert(String graph, String value) {
        return "INSERT DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> " + value + " } }";
    }

    private void update(String text) {
        try (RDFConnection connection = connection()) {
            connection.update(text);
        }
    }

    private boolean has(String graph, String value) {
        try (RDFConnection connection = connection()) {
            return connection.queryAsk("ASK { GRAPH <" + graph + "> { <urn:s> <urn:p> " + value + " } }");
        }
    }

    private void expect(String graph, String value) {
        Checks.yes(has(graph, value), "no " + value + " in " + graph);
    }

    private void expectNot(String graph, String value) {
        Checks.yes(!has(graph, value), value + " in " + graph);
    }

    private void run(Checks checks) {
        calls(checks);
        sending(checks);
        operations(checks);
        graphs(checks);
        errors(checks);
    }

    private void calls(Checks checks) {
        checks.check("update of a string", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            expect(graph, "1");
        });
        checks.check("update of a request", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.update(UpdateFactory.create(insert(graph, "1") + "; " + insert(graph, "2")));
            }
            expect(graph, "1");
            expect(graph, "2");
        });
        checks.check("update of an update", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.update(UpdateFactory.create(insert(graph, "1")).getOperations().get(0));
            }
            expect(graph, "1");
        });
        checks.check("newUpdate with a substitution", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.newUpdate().update("INSERT { GRAPH <" + graph + "> { <urn:s> <urn:p> ?x } } WHERE {}")
                    .substitution("x", ResourceFactory.createTypedLiteral(7)).execute();
            }
            expect(graph, "'7'^^<http://www.w3.org/2001/XMLSchema#int>");
        });
        checks.check("an update within a transaction of the connection", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                Txn.executeWrite(connection, () -> connection.update(insert(graph, "1")));
            }
            expect(graph, "1");
        });
        checks.check("a long update", () -> {
            String graph = fresh();
            StringBuilder text = new StringBuilder("INSERT DATA { GRAPH <" + graph + "> {");
            for (int i = 0; i < 5000; i++) text.append(" <urn:s> <urn:p> ").append(i).append(" .");
            update(text.append(" } }").toString());
            expect(graph, "4999");
        });
        checks.check("an update with letters of all kinds", () -> {
            String graph = fresh();
            update(insert(graph, "'\u00e4\u6f22\ud83e\udd16'@de"));
            expect(graph, "'\u00e4\u6f22\ud83e\udd16'@de");
        });
        checks.check("an update of the robot", () -> {
            String graph = url + "resources/cockpit/night";
            for (String value : new String[] {"true", "false"}) {
                update("PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> WITH <" + graph
                    + "> DELETE { ?s rdf:value ?o } INSERT { ?s rdf:value " + value + " } WHERE { ?s rdf:value ?o }");
                try (RDFConnection connection = connection()) {
                    Checks.yes(connection.queryAsk("PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> ASK { GRAPH <"
                        + graph + "> { ?s rdf:value " + value + " } }"), "not " + value);
                }
            }
        });
    }

    private void sent(UpdateSendMode mode) {
        String graph = fresh();
        try (RDFConnection connection = JenaQuery.builder(url).updateSendMode(mode).build()) {
            connection.update(insert(graph, "'a+b&c=%'"));
        }
        expect(graph, "'a+b&c=%'");
    }

    private void sending(Checks checks) {
        checks.check("sent as a body", () -> sent(UpdateSendMode.asPost));
        checks.check("sent as a form", () -> sent(UpdateSendMode.asPostForm));
        checks.check("using-graph-uri", () -> {
            String from = fresh();
            String to = fresh();
            update(insert(from, "1"));
            UpdateExecutionHTTP.service(url + "sparql").addUsingGraphURI(from)
                .update("INSERT { GRAPH <" + to
                    + "> { ?s ?p ?o } } WHERE { ?s ?p ?o . FILTER(?p = <urn:p>) }").build().execute();
            expect(to, "1");
        });
        checks.check("using-named-graph-uri in a form", () -> {
            String from = fresh();
            String to = fresh();
            update(insert(from, "1"));
            UpdateExecutionHTTP.service(url + "sparql").sendMode(UpdateSendMode.asPostForm).addUsingNamedGraphURI(from)
                .update("INSERT { GRAPH <" + to
                    + "> { ?s <urn:p> ?o } } WHERE { GRAPH ?g { ?s <urn:p> ?o } }").build().execute();
            expect(to, "1");
        });
    }

    private void operations(Checks checks) {
        checks.check("DELETE DATA", () -> {
            String graph = fresh();
            update(insert(graph, "1, 2"));
            update("DELETE DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> 1 } }");
            expectNot(graph, "1");
            expect(graph, "2");
        });
        checks.check("DELETE WHERE", () -> {
            String graph = fresh();
            update(insert(graph, "1, 2"));
            update("DELETE WHERE { GRAPH <" + graph + "> { <urn:s> <urn:p> ?o } }");
            expectNot(graph, "?o");
        });
        checks.check("DELETE and INSERT", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("WITH <" + graph
                + "> DELETE { ?s ?p ?o } INSERT { ?s ?p ?n } WHERE { ?s ?p ?o . FILTER(?p = <urn:p>) BIND(?o + 1 AS ?n) }");
            expect(graph, "2");
            expectNot(graph, "1");
        });
        checks.check("INSERT of blank nodes", () -> {
            String graph = fresh();
            update("INSERT DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> [ <urn:q> 1 ] } }");
            expect(graph, "[ <urn:q> 1 ]");
        });
        checks.check("USING", () -> {
            String from = fresh();
            String to = fresh();
            update(insert(from, "1"));
            update("INSERT { GRAPH <" + to + "> { ?s <urn:p> ?o } } USING <" + from + "> WHERE { ?s <urn:p> ?o }");
            expect(to, "1");
        });
        checks.check("several operations see each other", () -> {
            String from = fresh();
            String to = fresh();
            update(insert(from, "1") + "; INSERT { GRAPH <" + to + "> { ?s ?p ?o } } WHERE { GRAPH <" + from
                + "> { ?s ?p ?o . FILTER(?p = <urn:p>) } }");
            expect(to, "1");
        });
        checks.check("LOAD of a graph that may not be loaded is refused", () ->
            Checks.fails(HttpException.class, "403", () -> update("LOAD <http://127.0.0.1:9/x> INTO GRAPH <" + fresh()
                + ">")));
    }

    private void graphs(Checks checks) {
        checks.check("CREATE GRAPH", () -> {
            String graph = fresh();
            update("CREATE GRAPH <" + graph + ">");
            update(insert(graph, "1"));
            expect(graph, "1");
        });
        checks.check("CREATE SILENT GRAPH of one that exists", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("CREATE SILENT GRAPH <" + graph + ">");
            expect(graph, "1");
        });
        checks.check("CLEAR GRAPH", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("CLEAR GRAPH <" + graph + ">");
            expectNot(graph, "?o");
        });
        checks.check("DROP GRAPH", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("DROP GRAPH <" + graph + ">");
            expectNot(graph, "?o");
        });
        checks.check("DROP SILENT GRAPH of one that does not exist", () -> update("DROP SILENT GRAPH <" + fresh()
            + ">"));
        checks.check("DROP, then INSERT", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("DROP GRAPH <" + graph + ">");
            update(insert(graph, "2"));
            expect(graph, "2");
            expectNot(graph, "1");
        });
        checks.check("DROP and INSERT in one request", () -> {
            String graph = fresh();
            update(insert(graph, "1"));
            update("DROP SILENT GRAPH <" + graph + "> ; " + insert(graph, "2"));
            expect(graph, "2");
            expectNot(graph, "1");
        });
        checks.check("COPY", () -> transferred("COPY", false, true));
        checks.check("MOVE", () -> transferred("MOVE", false, false));
        checks.check("ADD", () -> transferred("ADD", true, true));
    }

    /** What becomes of the target's own triple, and of the source. */
    private void transferred(String operation, boolean merges, boolean keeps) {
        String from = fresh();
        String to = fresh();
        update(insert(from, "1") + "; " + insert(to, "2"));
        update(operation + " <" + from + "> TO <" + to + ">");
        expect(to, "1");
        Checks.equal(merges, has(to, "2"));
        Checks.equal(keeps, has(from, "1"));
    }

    private void errors(Checks checks) {
        checks.check("an update of bad syntax is refused by 400", () -> {
            try (RDFConnection connection = JenaQuery.builder(url).parseCheckSPARQL(false).build()) {
                Checks.fails(HttpException.class, "400", () -> connection.update("INSERT DATA {"));
            }
        });
        checks.check("an update of a sensor is refused by 403", () -> Checks.fails(HttpException.class, "403",
            () -> update(insert(url + "topics/aircraft/engine/speed", "1"))));
        checks.check("an insertion into the default graph goes to the default document", () -> {
            update("INSERT DATA { <urn:s> <urn:p> 1 }");
            update("DELETE { GRAPH <" + url + "data/default> { ?s <urn:p> 1 } } WHERE { GRAPH <" + url
                + "data/default> { ?s <urn:p> 1 } }");
        });
        checks.check("an update after a refused one is carried out", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                Checks.fails(HttpException.class, "403",
                    () -> connection.update(insert(url + "topics/aircraft/engine/speed", "1")));
                connection.update(insert(graph, "1"));
            }
            expect(graph, "1");
        });
    }
}
