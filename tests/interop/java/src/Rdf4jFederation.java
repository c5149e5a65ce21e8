import java.util.ArrayList;
import java.util.List;
import java.util.TreeSet;
import java.util.stream.IntStream;
import org.eclipse.rdf4j.model.ValueFactory;
import org.eclipse.rdf4j.query.BindingSet;
import org.eclipse.rdf4j.query.QueryEvaluationException;
import org.eclipse.rdf4j.query.QueryResults;
import org.eclipse.rdf4j.query.TupleQueryResult;
import org.eclipse.rdf4j.repository.RepositoryConnection;
import org.eclipse.rdf4j.repository.sail.SailRepository;
import org.eclipse.rdf4j.repository.sparql.SPARQLRepository;
import org.eclipse.rdf4j.sail.memory.MemoryStore;

/** RDF4J's SailRepository: queries over triples in memory that ask rosld by SERVICE. */
final class Rdf4jFederation {
    private static final String MISSING = "http://127.0.0.1:9/sparql";
    private static final int BLOCKS = 40; // more solutions than RDF4J sends at once, which is 15

    private final String url;
    private final String endpoint;
    private final String graph;

    private Rdf4jFederation(String url) {
        this.url = url;
        endpoint = url + "sparql";
        graph = url + "data/rdf4j/federated";
    }

    static void run(String url) {
        new Rdf4jFederation(url).run(new Checks("Rdf4jFederation"));
    }

    /** What is done with a repository in memory. */
    private interface Task<T> {
        T run(RepositoryConnection connection);
    }

    /** It has numbered triples under `urn:key`, every second of which is the subject of one of rosld's. */
    private static <T> T local(Task<T> task) {
        SailRepository repository = new SailRepository(new MemoryStore());
        try (RepositoryConnection connection = repository.getConnection()) {
            ValueFactory values = connection.getValueFactory();
            for (int i = 0; i < BLOCKS; i++)
                connection.add(values.createIRI("urn:local" + i), values.createIRI("urn:key"),
                    values.createIRI("urn:n" + i));
            return task.run(connection);
        } finally {
            repository.shutDown();
        }
    }

    private void update(String text) {
        try (RepositoryConnection connection = new SPARQLRepository(endpoint, endpoint).getConnection()) {
            connection.prepareUpdate(text).execute();
        }
    }

    private static List<BindingSet> rows(String text) {
        return local(connection -> {
            try (TupleQueryResult rows = connection.prepareTupleQuery(text).evaluate()) {
                return QueryResults.asList(rows);
            }
        });
    }

    private static TreeSet<String> values(String text) {
        TreeSet<String> found = new TreeSet<>();
        List<BindingSet> rows = rows(text);
        rows.forEach(row -> found.add(row.getValue("o").stringValue()));
        Checks.equal(rows.size(), found.size());
        return found;
    }

    private static boolean asked(String text) {
        return local(connection -> connection.prepareBooleanQuery(text).evaluate());
    }

    private static void holds(String text, String... values) {
        Checks.equal(new TreeSet<>(List.of(values)), values(text));
    }

    private String service(String pattern) {
        return " SERVICE <" + endpoint + "> { GRAPH <" + graph + "> { " + pattern + " } } ";
    }

    private void run(Checks checks) {
        checks.check("what is asked for is inserted", () -> {
            update("INSERT DATA { GRAPH <" + graph
                + "> { <urn:s> <urn:p> 1, 'a', '\u00e4\\n\"' } }");
            StringBuilder text = new StringBuilder("INSERT DATA { GRAPH <" + graph + "> {");
            for (int i = 0; i < BLOCKS; i += 2)
                text.append(" <urn:n").append(i).append("> <urn:q> ").append(i).append(" .");
            update(text.append(" } }").toString());
        });
        plain(checks);
        joins(checks);
        outside(checks);
        errors(checks);
    }

    private void plain(Checks checks) {
        checks.check("SERVICE", () -> holds("SELECT ?o {" + service("?s <urn:p> ?o") + "}", "1", "a", "\u00e4\n\""));
        checks.check("SERVICE that is a variable", () -> holds("SELECT ?o { VALUES ?at { <" + endpoint
            + "> } SERVICE ?at { GRAPH <" + graph + "> { ?s <urn:p> ?o } } }", "1", "a", "\u00e4\n\""));
        checks.check("SERVICE SILENT", () -> holds("SELECT ?o { SERVICE SILENT <" + endpoint + "> { GRAPH <" + graph
            + "> { ?s <urn:p> ?o } } }", "1", "a", "\u00e4\n\""));
        checks.check("SERVICE with a FILTER", () -> holds("SELECT ?o {"
            + service("?s <urn:p> ?o FILTER(isNumeric(?o))") + "}", "1"));
        checks.check("SERVICE with an OPTIONAL", () -> {
            List<BindingSet> rows = rows("SELECT ?o ?x {" + service("?s <urn:p> ?o OPTIONAL { ?s <urn:none> ?x }")
                + "}");
            Checks.equal(3, rows.size());
            Checks.yes(rows.stream().noneMatch(row -> row.hasBinding("x")), rows);
        });
        checks.check("SERVICE with a sub-query", () -> holds("SELECT ?o { SERVICE <" + endpoint
            + "> { SELECT ?o { GRAPH <" + graph + "> { ?s <urn:q> ?o } } ORDER BY DESC(?o) LIMIT 2 } }", "38", "36"));
        checks.check("SERVICE with prefixes", () -> holds("PREFIX u: <urn:> SELECT ?o {"
            + service("u:s u:p ?o FILTER(?o = 'a')") + "}", "a"));
        checks.check("SERVICE with a property path", () -> holds("SELECT ?o {"
            + service("<urn:n2> <urn:none>*/<urn:q> ?o") + "}", "2"));
        checks.check("SERVICE of a value of the robot", () -> Checks.equal(1, rows(
            "PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> SELECT ?o { SERVICE <" + endpoint + "> { <" + url
                + "resources/aircraft/power> rdf:value ?o } }").size()));
    }

    private void joins(Checks checks) {
        String[] even = IntStream.range(0, BLOCKS / 2).mapToObj(i -> String.valueOf(2 * i)).toArray(String[]::new);
        checks.check("SERVICE with VALUES from outside", () -> holds("SELECT ?o { VALUES ?o { 'a' 'z' }"
            + service("?s <urn:p> ?o") + "}", "a"));
        checks.check("SERVICE with VALUES from outside that may be undefined", () -> Checks.equal(4, rows(
            "SELECT ?s ?o { VALUES (?s ?o) { (UNDEF 'a') (<urn:s> UNDEF) (<urn:s> 'z') }" + service("?s <urn:p> ?o")
                + "}").size()));
        checks.check("SERVICE joined with triples in memory, in blocks", () -> holds(
            "SELECT ?o { ?local <urn:key> ?s ." + service("?s <urn:q> ?o") + "}", even));
        checks.check("SERVICE joined with triples in memory, from a sub-query", () -> holds(
            "SELECT ?o { { SELECT ?s { ?local <urn:key> ?s } }" + service("?s <urn:q> ?o") + "}", even));
        checks.check("SERVICE whose variables are all bound from outside", () -> Checks.equal(1, rows(
            "SELECT ?s ?o { VALUES (?s ?o) { (<urn:s> 'a') (<urn:s> 'z') }" + service("?s <urn:p> ?o") + "}").size()));
        checks.check("SERVICE without a variable", () -> {
            Checks.yes(!rows("SELECT * { <urn:local0> <urn:key> ?x ." + service("<urn:s> <urn:p> 'a'")
                + "}").isEmpty(), "no solution");
            Checks.equal(0, rows("SELECT * { <urn:local0> <urn:key> ?x ." + service("<urn:s> <urn:p> 'z'")
                + "}").size());
        });
        checks.check("OPTIONAL SERVICE", () -> {
            List<BindingSet> rows = rows("SELECT ?s ?o { ?local <urn:key> ?s OPTIONAL {" + service("?s <urn:q> ?o")
                + "} }");
            Checks.equal(BLOCKS, rows.size());
            Checks.equal((long) BLOCKS / 2, rows.stream().filter(row -> row.hasBinding("o")).count());
        });
        checks.check("MINUS SERVICE", () -> Checks.equal(BLOCKS / 2, rows("SELECT ?s { ?local <urn:key> ?s MINUS {"
            + service("?s <urn:q> ?o") + "} }").size()));
        checks.check("FILTER EXISTS SERVICE", () -> Checks.equal(BLOCKS / 2, rows(
            "SELECT ?s { ?local <urn:key> ?s FILTER EXISTS {" + service("?s <urn:q> ?o") + "} }").size()));
        checks.check("UNION of two SERVICEs", () -> holds("SELECT ?o { {" + service("<urn:n2> <urn:q> ?o") + "} UNION {"
            + service("<urn:n4> <urn:q> ?o") + "} }", "2", "4"));
        checks.check("two SERVICEs, the second joined with the first", () -> holds("SELECT ?o {"
            + service("?s <urn:q> 2") + service("?s <urn:q> ?o") + "}", "2"));
    }

    private void outside(Checks checks) {
        checks.check("FILTER outside of SERVICE", () -> holds("SELECT ?o {" + service("?s <urn:q> ?o")
            + "FILTER(?o > 35) }", "36", "38"));
        checks.check("an aggregate outside of SERVICE", () -> {
            List<BindingSet> rows = rows("SELECT (COUNT(?o) AS ?n) (SUM(?o) AS ?sum) {" + service("?s <urn:q> ?o")
                + "}");
            Checks.equal("20", rows.get(0).getValue("n").stringValue());
            Checks.equal("380", rows.get(0).getValue("sum").stringValue());
        });
        checks.check("ORDER BY and LIMIT outside of SERVICE", () -> {
            List<String> found = new ArrayList<>();
            rows("SELECT ?o {" + service("?s <urn:q> ?o") + "} ORDER BY DESC(?o) LIMIT 2").forEach(row ->
                found.add(row.getValue("o").stringValue()));
            Checks.equal(List.of("38", "36"), found);
        });
        checks.check("ASK of SERVICE", () -> {
            Checks.yes(asked("ASK {" + service("<urn:s> <urn:p> ?o") + "}"), "false");
            Checks.yes(!asked("ASK {" + service("<urn:none> <urn:p> ?o") + "}"), "true");
        });
        checks.check("CONSTRUCT of SERVICE", () -> Checks.equal(3, local(connection -> QueryResults.asModel(
            connection.prepareGraphQuery("CONSTRUCT { ?s <urn:r> ?o } WHERE {" + service("?s <urn:p> ?o")
                + "}").evaluate()).size())));
        checks.check("INSERT of what SERVICE finds", () -> Checks.equal(3L, local(connection -> {
            connection.prepareUpdate("INSERT { ?s <urn:r> ?o } WHERE {" + service("?s <urn:p> ?o") + "}").execute();
            return connection.getStatements(null, connection.getValueFactory().createIRI("urn:r"), null)
                .stream().count();
        })));
    }

    private void errors(Checks checks) {
        checks.check("SERVICE SILENT of an endpoint that is missing", () -> holds(
            "SELECT ?o { <urn:local0> <urn:key> ?o SERVICE SILENT <" + MISSING + "> { ?o <urn:q> ?x } }", "urn:n0"));
        checks.check("SERVICE of an endpoint that is missing fails", () -> Checks.fails(QueryEvaluationException.class,
            "", () -> rows("SELECT ?x { SERVICE <" + MISSING + "> { ?o <urn:q> ?x } }")));
    }
}
