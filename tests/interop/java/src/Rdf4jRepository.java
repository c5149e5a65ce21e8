import java.io.StringReader;
import java.util.ArrayList;
import java.util.List;
import java.util.Set;
import java.util.TreeSet;
import java.util.function.Consumer;
import org.eclipse.rdf4j.model.IRI;
import org.eclipse.rdf4j.model.Model;
import org.eclipse.rdf4j.model.Statement;
import org.eclipse.rdf4j.model.Value;
import org.eclipse.rdf4j.model.ValueFactory;
import org.eclipse.rdf4j.model.impl.LinkedHashModel;
import org.eclipse.rdf4j.model.impl.SimpleValueFactory;
import org.eclipse.rdf4j.model.util.Statements;
import org.eclipse.rdf4j.query.BooleanQuery;
import org.eclipse.rdf4j.query.GraphQuery;
import org.eclipse.rdf4j.query.MalformedQueryException;
import org.eclipse.rdf4j.query.QueryEvaluationException;
import org.eclipse.rdf4j.query.QueryResults;
import org.eclipse.rdf4j.query.TupleQuery;
import org.eclipse.rdf4j.query.TupleQueryResult;
import org.eclipse.rdf4j.query.Update;
import org.eclipse.rdf4j.query.UpdateExecutionException;
import org.eclipse.rdf4j.query.impl.SimpleDataset;
import org.eclipse.rdf4j.repository.RepositoryConnection;
import org.eclipse.rdf4j.repository.RepositoryException;
import org.eclipse.rdf4j.repository.sparql.SPARQLRepository;
import org.eclipse.rdf4j.rio.RDFFormat;
import org.eclipse.rdf4j.rio.helpers.StatementCollector;

/** RDF4J's SPARQLRepository: a remote endpoint as if it were a repository. */
final class Rdf4jRepository {
    private static final ValueFactory VALUES = SimpleValueFactory.getInstance();
    private static final IRI S = VALUES.createIRI("urn:s");
    private static final IRI P = VALUES.createIRI("urn:p");

    private final String url;
    private final SPARQLRepository repository;
    private int counter;

    private Rdf4jRepository(String url) {
        this.url = url;
        repository = new SPARQLRepository(url + "sparql", url + "sparql");
    }

    static void run(String url) {
        new Rdf4jRepository(url).run(new Checks("Rdf4jRepository"));
    }

    private IRI fresh() {
        return VALUES.createIRI(url + "data/rdf4j/r" + ++counter);
    }

    private void with(Consumer<RepositoryConnection> what) {
        try (RepositoryConnection connection = Calls.noted(RepositoryConnection.class,
                repository.getConnection())) {
            what.accept(connection);
        }
    }

    private static void insert(RepositoryConnection connection, IRI graph, String values) {
        connection.prepareUpdate("INSERT DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> " + values + " } }").execute();
    }

    private static Set<String> values(RepositoryConnection connection, IRI graph) {
        Set<String> found = new TreeSet<>();
        try (TupleQueryResult rows = connection.prepareTupleQuery("SELECT ?o { GRAPH <" + graph
            + "> { <urn:s> <urn:p> ?o } }").evaluate()) {
            rows.forEach(row -> found.add(row.getValue("o").stringValue()));
        }
        return found;
    }

    private static void holds(RepositoryConnection connection, IRI graph, String... values) {
        Checks.equal(new TreeSet<>(List.of(values)), values(connection, graph));
    }

    private void run(Checks checks) {
        queries(checks);
        reading(checks);
        updates(checks);
        writing(checks);
        transactions(checks);
        errors(checks);
    }

    private void queries(Checks checks) {
        checks.check("prepareTupleQuery", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a', '\u00e4\\n'@de");
            holds(connection, graph, "1", "a", "\u00e4\n");
        }));
        checks.check("prepareTupleQuery with a binding", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            TupleQuery query = connection.prepareTupleQuery("SELECT ?o { GRAPH ?g { ?s <urn:p> ?o } }");
            query.setBinding("g", graph);
            query.setBinding("s", S);
            try (TupleQueryResult rows = query.evaluate()) {
                Checks.equal(2, QueryResults.asList(rows).size());
            }
        }));
        checks.check("prepareTupleQuery into a handler", () -> with(connection -> {
            List<String> seen = new ArrayList<>();
            connection.prepareTupleQuery("SELECT ?x { VALUES ?x { 1 2 3 } }").evaluate(new
                org.eclipse.rdf4j.query.AbstractTupleQueryResultHandler() {
                @Override
                public void handleSolution(org.eclipse.rdf4j.query.BindingSet row) {
                    seen.add(row.getValue("x").stringValue());
                }
            });
            Checks.equal(3, seen.size());
        }));
        checks.check("prepareBooleanQuery", () -> with(connection -> {
            Checks.yes(connection.prepareBooleanQuery("ASK { ?s ?p ?o }").evaluate(), "false");
            Checks.yes(!connection.prepareBooleanQuery("ASK { <urn:none> ?p ?o }").evaluate(), "true");
        }));
        checks.check("prepareBooleanQuery with a binding", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            BooleanQuery query = connection.prepareBooleanQuery("ASK { GRAPH ?g { ?s ?p 'a' } }");
            query.setBinding("g", graph);
            Checks.yes(query.evaluate(), "false");
        }));
        checks.check("prepareGraphQuery of a CONSTRUCT", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            GraphQuery query = connection.prepareGraphQuery("CONSTRUCT { ?s ?p ?o } WHERE { GRAPH <" + graph
                + "> { ?s ?p ?o . FILTER(?p = <urn:p>) } }");
            Checks.equal(2, QueryResults.asModel(query.evaluate()).size());
        }));
        checks.check("prepareGraphQuery of a DESCRIBE", () -> with(connection -> Checks.yes(QueryResults.asModel(
            connection.prepareGraphQuery("DESCRIBE <" + url + "topics/aircraft/engine/speed>").evaluate()).size() > 5,
                "too small")));
        checks.check("prepareGraphQuery into a handler", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            StatementCollector found = new StatementCollector();
            connection.prepareGraphQuery("CONSTRUCT { ?s <urn:p> ?o } WHERE { GRAPH <" + graph
                + "> { ?s <urn:p> ?o } }").evaluate(found);
            Checks.equal(2, found.getStatements().size());
        }));
        checks.check("prepareQuery of any form", () -> with(connection ->
            Checks.yes(connection.prepareQuery("ASK {}") instanceof BooleanQuery, "another form")));
        checks.check("a dataset of default graphs", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            SimpleDataset dataset = new SimpleDataset();
            dataset.addDefaultGraph(graph);
            TupleQuery query = connection.prepareTupleQuery("SELECT ?o { ?s <urn:p> ?o }");
            query.setDataset(dataset);
            try (TupleQueryResult rows = query.evaluate()) {
                Checks.equal(2, QueryResults.asList(rows).size());
            }
        }));
        checks.check("a dataset of named graphs", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            SimpleDataset dataset = new SimpleDataset();
            dataset.addNamedGraph(graph);
            TupleQuery query = connection.prepareTupleQuery("SELECT ?g ?o { GRAPH ?g { ?s <urn:p> ?o } }");
            query.setDataset(dataset);
            try (TupleQueryResult rows = query.evaluate()) {
                Checks.equal(2, QueryResults.asList(rows).size());
            }
        }));
        checks.check("a limit of time", () -> with(connection -> {
            TupleQuery query = connection.prepareTupleQuery("SELECT (1 AS ?x) {}");
            query.setMaxExecutionTime(5);
            try (TupleQueryResult rows = query.evaluate()) {
                Checks.equal(1, QueryResults.asList(rows).size());
            }
        }));
        checks.check("a long query", () -> with(connection ->
            Checks.yes(connection.prepareBooleanQuery("# " + "long ".repeat(2000) + "\nASK {}").evaluate(), "false")));
        checks.check("a literal with a control character", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a\\u0001b'");
            holds(connection, graph, "a\u0001b");
        }));
        checks.check("everything of the robot", () -> with(connection -> {
            try (TupleQueryResult rows = connection.prepareTupleQuery("SELECT * { ?s ?p ?o }").evaluate()) {
                Checks.yes(QueryResults.asList(rows).size() > 500, "too few");
            }
        }));
    }

    private void reading(Checks checks) {
        checks.check("getStatements of a graph", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            Checks.equal(2, QueryResults.asList(connection.getStatements(S, P, null, graph)).size());
        }));
        checks.check("getStatements of the union", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'of the union'");
            Checks.equal(1, QueryResults.asList(connection.getStatements(S, P,
                VALUES.createLiteral("of the union"))).size());
        }));
        checks.check("getStatements of everything", () -> with(connection ->
            Checks.yes(QueryResults.asList(connection.getStatements(null, null, null)).size() > 500, "too few")));
        checks.check("hasStatement", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            Checks.yes(connection.hasStatement(S, P, VALUES.createLiteral("a"), false, graph), "not there");
            Checks.yes(!connection.hasStatement(S, P, VALUES.createLiteral("z"), false, graph), "there");
        }));
        checks.check("size of the union", () -> with(connection -> Checks.yes(connection.size() > 500,
            connection.size())));
        checks.check("isEmpty", () -> with(connection -> Checks.yes(!connection.isEmpty(), "empty")));
        checks.check("getContextIDs", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1");
            Checks.yes(QueryResults.asList(connection.getContextIDs()).contains(graph), "not listed");
        }));
        checks.check("export of a graph", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            StatementCollector found = new StatementCollector();
            connection.export(found, graph);
            Checks.equal(2L, found.getStatements().stream().filter(one -> one.getPredicate().equals(P)).count());
        }));
        checks.check("exportStatements of a pattern", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1, 'a'");
            StatementCollector found = new StatementCollector();
            connection.exportStatements(S, P, null, false, found, graph);
            Checks.equal(2, found.getStatements().size());
        }));
        checks.check("quads where they are asked for", () -> {
            SPARQLRepository quads = new SPARQLRepository(url + "sparql", url + "sparql");
            quads.enableQuadMode(true);
            try (RepositoryConnection connection = quads.getConnection()) {
                IRI graph = fresh();
                insert(connection, graph, "'in a graph'");
                List<Statement> found = QueryResults.asList(connection.getStatements(S, P,
                    VALUES.createLiteral("in a graph")));
                Checks.equal(1, found.size());
                Checks.equal(graph, found.get(0).getContext());
            }
        });
    }

    private void updates(Checks checks) {
        checks.check("prepareUpdate with a binding", () -> with(connection -> {
            IRI graph = fresh();
            Update update = connection.prepareUpdate("INSERT { GRAPH ?g { <urn:s> <urn:p> ?o } } WHERE { VALUES ?x { 1 } }");
            update.setBinding("g", graph);
            update.setBinding("o", VALUES.createLiteral("bound"));
            update.execute();
            holds(connection, graph, "bound");
        }));
        checks.check("prepareUpdate with a dataset", () -> with(connection -> {
            IRI from = fresh();
            IRI to = fresh();
            insert(connection, from, "1");
            SimpleDataset dataset = new SimpleDataset();
            dataset.addDefaultGraph(from);
            Update update = connection.prepareUpdate("INSERT { GRAPH <" + to
                + "> { ?s <urn:p> ?o } } WHERE { ?s <urn:p> ?o }");
            update.setDataset(dataset);
            update.execute();
            holds(connection, to, "1");
        }));
        checks.check("DELETE and INSERT", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "1");
            connection.prepareUpdate("WITH <" + graph
                + "> DELETE { ?s ?p ?o } INSERT { ?s ?p 2 } WHERE { ?s ?p ?o . FILTER(?p = <urn:p>) }").execute();
            holds(connection, graph, "2");
        }));
        checks.check("an update of the robot", () -> with(connection -> {
            String graph = url + "resources/cockpit/brightness";
            for (String value : new String[] {"0.25", "0.8"})
                connection.prepareUpdate("PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> WITH <" + graph
                    + "> DELETE { ?s rdf:value ?o } INSERT { ?s rdf:value " + value
                        + "e0 } WHERE { ?s rdf:value ?o }").execute();
        }));
    }

    private void writing(Checks checks) {
        checks.check("add of a statement", () -> with(connection -> {
            IRI graph = fresh();
            connection.add(S, P, VALUES.createLiteral("a\"\n\u00e4"), graph);
            holds(connection, graph, "a\"\n\u00e4");
        }));
        checks.check("add of statements", () -> with(connection -> {
            IRI graph = fresh();
            Model model = new LinkedHashModel();
            for (int i = 0; i < 1000; i++) model.add(S, P, VALUES.createLiteral(i));
            connection.add(model, graph);
            Checks.equal(1000, values(connection, graph).size());
        }));
        checks.check("add of a document", () -> with(connection -> {
            IRI graph = fresh();
            try {
                connection.add(new StringReader("<urn:s> <urn:p> 'a', [ <urn:q> 1 ] ."), "", RDFFormat.TURTLE, graph);
            } catch (java.io.IOException error) {
                throw new AssertionError(error);
            }
            Checks.equal(2, values(connection, graph).size());
        }));
        checks.check("add of a page by its URL", () -> with(connection -> {
            IRI graph = fresh();
            try {
                connection.add(new java.net.URL(url + "nodes/aircraft"), graph);
            } catch (java.io.IOException error) {
                throw new AssertionError(error);
            }
            Checks.yes(connection.hasStatement(VALUES.createIRI(url + "nodes/aircraft"), null, null, false, graph), "none");
        }));
        checks.check("remove of a statement", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a', 'b'");
            connection.remove(S, P, VALUES.createLiteral("a"), graph);
            holds(connection, graph, "b");
        }));
        checks.check("remove of statements", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a', 'b', 'c'");
            connection.remove(List.of(Statements.statement(S, P, VALUES.createLiteral("a"), null),
                Statements.statement(S, P, VALUES.createLiteral("b"), null)), graph);
            holds(connection, graph, "c");
        }));
        checks.check("remove of a pattern", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a', 'b'");
            connection.remove(S, P, (Value) null, graph);
            holds(connection, graph);
        }));
        checks.check("clear of a graph", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a', 'b'");
            connection.clear(graph);
            holds(connection, graph);
        }));
        checks.check("clear, then add", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            connection.clear(graph);
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            holds(connection, graph, "b");
        }));
    }

    private void transactions(Checks checks) {
        checks.check("begin, add, remove, commit", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            connection.begin();
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            connection.remove(S, P, VALUES.createLiteral("a"), graph);
            holds(connection, graph, "a");
            connection.commit();
            holds(connection, graph, "b");
        }));
        checks.check("begin, add, rollback", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            connection.begin();
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            connection.rollback();
            holds(connection, graph, "a");
        }));
        checks.check("begin, clear, add, commit", () -> with(connection -> {
            IRI graph = fresh();
            insert(connection, graph, "'a'");
            connection.begin();
            connection.clear(graph);
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            connection.commit();
            holds(connection, graph, "b");
        }));
    }

    private void errors(Checks checks) {
        checks.check("a query of bad syntax is refused", () -> with(connection -> {
            try {
                connection.prepareBooleanQuery("ASK { ?s ?p FILTER }").evaluate();
            } catch (MalformedQueryException | QueryEvaluationException error) {
                Checks.yes(error.toString().contains("1:13"), error);
                return;
            }
            throw new AssertionError("answered");
        }));
        checks.check("an update of a sensor is refused", () -> with(connection -> {
            try {
                insert(connection, VALUES.createIRI(url + "topics/aircraft/engine/speed"), "1");
            } catch (UpdateExecutionException | RepositoryException error) {
                Checks.yes(String.valueOf(error).contains("published") ||
                    String.valueOf(error.getCause()).contains("published"), error);
                return;
            }
            throw new AssertionError("done");
        }));
    }
}
