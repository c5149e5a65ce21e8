import java.io.InputStream;
import java.net.URLEncoder;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.List;
import java.util.Set;
import org.apache.jena.graph.Graph;
import org.apache.jena.query.DatasetFactory;
import org.apache.jena.query.QueryExecution;
import org.apache.jena.query.QueryExecutionFactory;
import org.apache.jena.query.QueryFactory;
import org.apache.jena.query.ResultSet;
import org.apache.jena.query.ResultSetFormatter;
import org.apache.jena.rdf.model.Model;
import org.apache.jena.rdf.model.ResourceFactory;
import org.apache.jena.rdfconnection.RDFConnection;
import org.apache.jena.rdfconnection.RDFConnectionRemote;
import org.apache.jena.rdfconnection.RDFConnectionRemoteBuilder;
import org.apache.jena.http.HttpOp;
import org.apache.jena.riot.WebContent;
import org.apache.jena.riot.rowset.rw.RowSetReaderTSV;
import org.apache.jena.sparql.engine.http.QueryExceptionHTTP;
import org.apache.jena.sparql.exec.http.QueryExecutionHTTP;
import org.apache.jena.sparql.exec.http.QuerySendMode;

/** Jena's RDFConnection: queries. */
final class JenaQuery {
    private final String url;
    private final String endpoint;
    private final String graph;

    private JenaQuery(String url) {
        this.url = url;
        endpoint = url + "sparql";
        graph = url + "data/jena/queried";
    }

    static RDFConnectionRemoteBuilder builder(String url) {
        return RDFConnectionRemote.newBuilder().destination(url)
            .queryEndpoint("sparql").updateEndpoint("sparql").gspEndpoint("graphs");
    }

    /** In the default configuration; its calls are noted. */
    static RDFConnection connection(String url) {
        return Calls.noted(RDFConnection.class, builder(url).build());
    }

    static void run(String url) {
        new JenaQuery(url).run(new Checks("JenaQuery"));
    }

    private RDFConnection connection() {
        return connection(url);
    }

    private String select() {
        return "SELECT ?o { GRAPH <" + graph + "> { <urn:s> <urn:p> ?o } } ORDER BY ?o";
    }

    private String construct() {
        return "CONSTRUCT { ?s ?p ?o } WHERE { GRAPH <" + graph + "> { ?s ?p ?o . FILTER(?s = <urn:s>) } }";
    }

    private String ask() {
        return "ASK { GRAPH <" + graph + "> { <urn:s> <urn:p> 'a' } }";
    }

    private static List<String> values(ResultSet results) {
        List<String> found = new ArrayList<>();
        results.forEachRemaining(row -> found.add(row.getLiteral("o").getLexicalForm()));
        return found;
    }

    private static final List<String> VALUES = List.of("1", "a", "\u00e4\n\"");

    private void run(Checks checks) {
        checks.check("an update makes what is queried", () -> {
            try (RDFConnection connection = connection()) {
                connection.update("INSERT DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> 1, 'a', '\u00e4\\n\"' } }");
            }
        });
        forms(checks);
        formats(checks);
        sending(checks);
        datasets(checks);
        errors(checks);
        federation(checks);
    }

    private void forms(Checks checks) {
        checks.check("queryResultSet of a string", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet(select(), results -> Checks.equal(Set.copyOf(VALUES),
                    Set.copyOf(values(results))));
            }
        });
        checks.check("queryResultSet of a query", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet(QueryFactory.create(select()), results -> Checks.equal(3,
                    values(results).size()));
            }
        });
        checks.check("querySelect of a string", () -> {
            List<String> found = new ArrayList<>();
            try (RDFConnection connection = connection()) {
                connection.querySelect(select(), row -> found.add(row.getLiteral("o").getLexicalForm()));
            }
            Checks.equal(VALUES.size(), found.size());
        });
        checks.check("querySelect of a query", () -> {
            List<String> found = new ArrayList<>();
            try (RDFConnection connection = connection()) {
                connection.querySelect(QueryFactory.create(select()), row ->
                    found.add(row.getLiteral("o").getLexicalForm()));
            }
            Checks.equal(VALUES.size(), found.size());
        });
        checks.check("queryAsk of a string", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.queryAsk(ask()), "false");
                Checks.yes(!connection.queryAsk(ask().replace("'a'", "'z'")), "true");
            }
        });
        checks.check("queryAsk of a query", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.queryAsk(QueryFactory.create(ask())), "false");
            }
        });
        checks.check("queryConstruct of a string", () -> {
            try (RDFConnection connection = connection()) {
                Checks.equal(3L, connection.queryConstruct(construct()).size());
            }
        });
        checks.check("queryConstruct of a query", () -> {
            try (RDFConnection connection = connection()) {
                Checks.equal(3L, connection.queryConstruct(QueryFactory.create(construct())).size());
            }
        });
        checks.check("queryDescribe of a string", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.queryDescribe("DESCRIBE <urn:s>").size() >= 3, "too few");
            }
        });
        checks.check("queryDescribe of a query", () -> {
            try (RDFConnection connection = connection()) {
                Model found = connection.queryDescribe(QueryFactory.create("DESCRIBE <" + url
                    + "topics/aircraft/engine/speed>"));
                Checks.yes(found.size() > 5, found);
            }
        });
        checks.check("query of a string, then execSelect", () -> {
            try (RDFConnection connection = connection(); QueryExecution execution = connection.query(select())) {
                Checks.equal(3, ResultSetFormatter.toList(execution.execSelect()).size());
            }
        });
        checks.check("query of a query, then execAsk", () -> {
            try (RDFConnection connection = connection();
                QueryExecution execution = connection.query(QueryFactory.create(ask()))) {
                Checks.yes(execution.execAsk(), "false");
            }
        });
        checks.check("query, then execConstructTriples", () -> {
            try (RDFConnection connection = connection(); QueryExecution execution = connection.query(construct())) {
                int[] count = {0};
                execution.execConstructTriples().forEachRemaining(triple -> count[0]++);
                Checks.equal(3, count[0]);
            }
        });
        checks.check("query, then execDescribeTriples", () -> {
            try (RDFConnection connection = connection();
                QueryExecution execution = connection.query("DESCRIBE <urn:s>")) {
                Checks.yes(execution.execDescribeTriples().hasNext(), "nothing");
            }
        });
        checks.check("an expression without a pattern", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet("SELECT (1 AS ?o) {}", results -> Checks.equal(List.of("1"),
                    values(results)));
            }
        });
        checks.check("newQuery with a substitution", () -> {
            try (RDFConnection connection = connection();
                 QueryExecution execution = connection.newQuery().query(ask().replace("'a'", "?what"))
                     .substitution("what", ResourceFactory.createPlainLiteral("a")).build()) {
                Checks.yes(execution.execAsk(), "false");
            }
        });
        checks.check("a sub-query, OPTIONAL, VALUES and an aggregate", () -> {
            String text = "SELECT (COUNT(?o) AS ?n) { { SELECT ?o { GRAPH ?g { ?s <urn:p> ?o } VALUES ?g { <" + graph
                + "> } } } OPTIONAL { ?o <urn:none> ?x } }";
            try (RDFConnection connection = connection()) {
                connection.querySelect(text, row -> Checks.equal(3, row.getLiteral("n").getInt()));
            }
        });
        checks.check("an unbound variable", () -> {
            try (RDFConnection connection = connection()) {
                connection.querySelect("SELECT ?x ?y { VALUES (?x ?y) { (1 UNDEF) } }", row ->
                    Checks.yes(!row.contains("y"), row));
            }
        });
        checks.check("everything of the robot", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet("SELECT * { ?s ?p ?o }", results -> {
                    int rows = 0;
                    for (; results.hasNext(); results.next()) rows++;
                    Checks.yes(rows > 500, rows);
                });
            }
        });
    }

    private void selected(String accepted) {
        try (RDFConnection connection = builder(url).acceptHeaderSelectQuery(accepted).build()) {
            connection.queryResultSet(select(), results -> Checks.equal(Set.copyOf(VALUES),
                Set.copyOf(values(results))));
        }
    }

    private void asked(String accepted) {
        try (RDFConnection connection = builder(url).acceptHeaderAskQuery(accepted).build()) {
            Checks.yes(connection.queryAsk(ask()), "false");
        }
    }

    private void constructed(String accepted) {
        try (RDFConnection connection = builder(url).acceptHeaderGraph(accepted).build()) {
            Checks.equal(3L, connection.queryConstruct(construct()).size());
        }
    }

    private void formats(Checks checks) {
        checks.check("SELECT as JSON", () -> selected(WebContent.contentTypeResultsJSON));
        checks.check("SELECT as XML", () -> selected(WebContent.contentTypeResultsXML));
        checks.check("SELECT as TSV", () -> selected(WebContent.contentTypeTextTSV));
        checks.check("SELECT as CSV", () -> selected(WebContent.contentTypeTextCSV));
        checks.check("SELECT as anything", () -> selected("*/*"));
        checks.check("ASK as JSON", () -> asked(WebContent.contentTypeResultsJSON));
        checks.check("ASK as XML", () -> asked(WebContent.contentTypeResultsXML));
        checks.check("ASK as CSV", () -> asked(WebContent.contentTypeTextCSV));
        // RDFConnection reads every TSV as a table of solutions, also its own writer's booleans.
        checks.check("ASK as TSV", () -> {
            String asked = endpoint + "?query=" + URLEncoder.encode(ask(), StandardCharsets.UTF_8);
            try (InputStream answer = HttpOp.httpGet(asked, WebContent.contentTypeTextTSV)) {
                Checks.yes(RowSetReaderTSV.booleanFromTSV(answer), "false");
            }
        });
        checks.check("CONSTRUCT as Turtle", () -> constructed(WebContent.contentTypeTurtle));
        checks.check("CONSTRUCT as N-Triples", () -> constructed(WebContent.contentTypeNTriples));
        checks.check("CONSTRUCT as RDF/XML", () -> constructed(WebContent.contentTypeRDFXML));
        checks.check("CONSTRUCT as JSON-LD", () -> constructed(WebContent.contentTypeJSONLD));
        checks.check("CONSTRUCT as N-Quads", () -> constructed(WebContent.contentTypeNQuads));
        checks.check("CONSTRUCT as TriG", () -> constructed(WebContent.contentTypeTriG));
        checks.check("CONSTRUCT as anything", () -> constructed("*/*"));
        checks.check("one Accept header for all forms", () -> {
            try (RDFConnection connection = builder(url).acceptHeaderQuery(WebContent.contentTypeResultsXML
                + ", text/turtle;q=0.9").build()) {
                Checks.yes(connection.queryAsk(ask()), "false");
                Checks.equal(3L, connection.queryConstruct(construct()).size());
            }
        });
    }

    private void sent(QuerySendMode mode, String comment) {
        try (RDFConnection connection = builder(url).querySendMode(mode).build()) {
            Checks.yes(connection.queryAsk(comment + ask()), "false");
            connection.queryResultSet(comment + select(), results -> Checks.equal(3, values(results).size()));
            Checks.equal(3L, connection.queryConstruct(comment + construct()).size());
        }
    }

    private void sending(Checks checks) {
        String comment = "# " + "long ".repeat(1000) + "\n";
        checks.check("sent by GET", () -> sent(QuerySendMode.asGetAlways, ""));
        checks.check("sent by GET, whatever its length", () -> sent(QuerySendMode.asGetAlways, comment));
        checks.check("sent as a form where it is long", () -> sent(QuerySendMode.asGetWithLimitForm, comment));
        checks.check("sent as a body where it is long", () -> sent(QuerySendMode.asGetWithLimitBody, comment));
        checks.check("sent as a form", () -> sent(QuerySendMode.asPostForm, ""));
        checks.check("sent as a body", () -> sent(QuerySendMode.asPost, ""));
        checks.check("a long form of all that is sent by default", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.queryAsk(comment + ask()), "false");
            }
        });
    }

    private void datasets(Checks checks) {
        String any = "SELECT ?o { ?s <urn:p> ?o }";
        checks.check("default-graph-uri", () -> {
            try (QueryExecution execution =
                QueryExecutionHTTP.service(endpoint).queryString(any).addDefaultGraphURI(graph).build()) {
                Checks.equal(3, values(execution.execSelect()).size());
            }
        });
        checks.check("named-graph-uri", () -> {
            try (QueryExecution execution = QueryExecutionHTTP.service(endpoint)
                .queryString("SELECT ?o { GRAPH ?g { ?s <urn:p> ?o } }").addNamedGraphURI(graph).build()) {
                Checks.equal(3, values(execution.execSelect()).size());
            }
        });
        checks.check("several graphs in a posted form", () -> {
            try (QueryExecution execution = QueryExecutionHTTP.service(endpoint).sendMode(QuerySendMode.asPostForm)
                .queryString(any).addDefaultGraphURI(graph).addDefaultGraphURI(url + "data/jena/none").build()) {
                Checks.equal(3, values(execution.execSelect()).size());
            }
        });
        checks.check("graphs beside a posted body", () -> {
            try (QueryExecution execution = QueryExecutionHTTP.service(endpoint).sendMode(QuerySendMode.asPost)
                .queryString(any).addDefaultGraphURI(graph).build()) {
                Checks.equal(3, values(execution.execSelect()).size());
            }
        });
        checks.check("FROM", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet("SELECT ?o FROM <" + graph + "> { ?s <urn:p> ?o }", results -> Checks.equal(3,
                    values(results).size()));
            }
        });
        checks.check("FROM NAMED", () -> {
            try (RDFConnection connection = connection()) {
                connection.queryResultSet("SELECT ?o FROM NAMED <" + graph + "> { GRAPH ?g { ?s <urn:p> ?o } }",
                    results -> Checks.equal(3, values(results).size()));
            }
        });
        checks.check("a limit of time", () -> {
            try (QueryExecution execution = QueryExecutionHTTP.service(endpoint).param("timeout",
                "5").queryString(any).timeout(10_000).build()) {
                Checks.yes(execution.execSelect().hasNext(), "nothing");
            }
        });
    }

    private void errors(Checks checks) {
        checks.check("a query of bad syntax is refused by 400", () -> {
            try (RDFConnection connection = builder(url).parseCheckSPARQL(false).build()) {
                Checks.fails(QueryExceptionHTTP.class, "400", () -> connection.queryAsk("ASK {"));
            }
        });
        checks.check("a format that does not exist is refused by 406", () -> {
            try (RDFConnection connection = builder(url).acceptHeaderSelectQuery("application/x-none").build()) {
                Checks.fails(QueryExceptionHTTP.class, "406", () -> connection.queryResultSet(select(), results ->
                    { }));
            }
        });
        checks.check("a request after a refused one is answered", () -> {
            try (RDFConnection connection = builder(url).parseCheckSPARQL(false).build()) {
                Checks.fails(QueryExceptionHTTP.class, "400", () -> connection.queryAsk("ASK {"));
                Checks.yes(connection.queryAsk(ask()), "false");
            }
        });
    }

    private static List<String> federated(String text) {
        try (QueryExecution execution = QueryExecutionFactory.create(text, DatasetFactory.create())) {
            return values(execution.execSelect());
        }
    }

    private void federation(Checks checks) {
        checks.check("SERVICE", () -> Checks.equal(3, federated("SELECT ?o { SERVICE <" + endpoint + "> { GRAPH <"
            + graph + "> { ?s <urn:p> ?o } } }").size()));
        checks.check("SERVICE with a join from outside", () -> Checks.equal(List.of("a"), federated(
            "SELECT ?o { VALUES ?o { 'a' 'z' } SERVICE <" + endpoint + "> { GRAPH <" + graph
                + "> { ?s <urn:p> ?o } } }")));
        checks.check("SERVICE that is a variable", () -> Checks.equal(3, federated(
            "SELECT ?o { VALUES ?at { <" + endpoint + "> } SERVICE ?at { GRAPH <" + graph
                + "> { ?s <urn:p> ?o } } }").size()));
        checks.check("SERVICE SILENT", () -> Checks.equal(3, federated("SELECT ?o { SERVICE SILENT <" + endpoint
            + "> { GRAPH <" + graph + "> { ?s <urn:p> ?o } } }").size()));
        checks.check("SERVICE with OPTIONAL and FILTER", () -> Checks.equal(List.of("1"), federated(
            "SELECT ?o { SERVICE <" + endpoint + "> { GRAPH <" + graph
                + "> { ?s <urn:p> ?o OPTIONAL { ?o <urn:q> ?x } FILTER(isNumeric(?o)) } } }")));
        checks.check("SERVICE with a sub-query", () -> Checks.equal(1, federated(
            "SELECT ?o { SERVICE <" + endpoint + "> { SELECT ?o { GRAPH <" + graph
                + "> { ?s <urn:p> ?o } } ORDER BY ?o LIMIT 1 } }").size()));
        checks.check("OPTIONAL SERVICE", () -> Checks.equal(2, federated(
            "SELECT ?o { VALUES ?o { 'a' 'z' } OPTIONAL { SERVICE <" + endpoint + "> { GRAPH <" + graph
                + "> { ?s <urn:p> ?o } } } }").size()));
        checks.check("SERVICE SILENT of an endpoint that is missing", () -> Checks.equal(List.of("a"), federated(
            "SELECT ?o { VALUES ?o { 'a' } SERVICE SILENT <http://127.0.0.1:9/sparql> { ?s <urn:p> ?x } }")));
        checks.check("FILTER and an aggregate outside of SERVICE", () -> Checks.equal(List.of("2"), federated(
            "SELECT (COUNT(?x) AS ?o) { SERVICE <" + endpoint + "> { GRAPH <" + graph
                + "> { ?s <urn:p> ?x } } FILTER(?x != 'a') }")));
        checks.check("ASK of SERVICE", () -> {
            for (String value : new String[] {"a", "z"}) {
                String text = "ASK { SERVICE <" + endpoint + "> { GRAPH <" + graph + "> { ?s <urn:p> '" + value
                    + "' } } }";
                try (QueryExecution execution = QueryExecutionFactory.create(text, DatasetFactory.create())) {
                    Checks.equal(value.equals("a"), execution.execAsk());
                }
            }
        });
    }
}
