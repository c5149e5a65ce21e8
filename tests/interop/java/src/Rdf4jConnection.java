import java.io.ByteArrayInputStream;
import java.io.File;
import java.io.InputStream;
import java.io.StringReader;
import java.net.URI;
import java.nio.charset.StandardCharsets;
import java.nio.file.Files;
import java.util.List;
import java.util.Map;
import java.util.Set;
import java.util.TreeSet;
import org.eclipse.rdf4j.common.iteration.CloseableIteration;
import org.eclipse.rdf4j.common.transaction.IsolationLevels;
import org.eclipse.rdf4j.common.transaction.TransactionSetting;
import org.eclipse.rdf4j.model.IRI;
import org.eclipse.rdf4j.model.Resource;
import org.eclipse.rdf4j.model.Statement;
import org.eclipse.rdf4j.model.Value;
import org.eclipse.rdf4j.model.ValueFactory;
import org.eclipse.rdf4j.model.impl.SimpleValueFactory;
import org.eclipse.rdf4j.query.GraphQuery;
import org.eclipse.rdf4j.query.QueryLanguage;
import org.eclipse.rdf4j.query.QueryResults;
import org.eclipse.rdf4j.query.TupleQuery;
import org.eclipse.rdf4j.query.Update;
import org.eclipse.rdf4j.query.impl.SimpleDataset;
import org.eclipse.rdf4j.repository.RepositoryConnection;
import org.eclipse.rdf4j.repository.RepositoryException;
import org.eclipse.rdf4j.repository.RepositoryResult;
import org.eclipse.rdf4j.repository.sparql.SPARQLRepository;
import org.eclipse.rdf4j.rio.RDFFormat;
import org.eclipse.rdf4j.rio.helpers.StatementCollector;

/** RDF4J's RepositoryConnection over SPARQLRepository: the calls beside those of Rdf4jRepository. */
final class Rdf4jConnection {
    private static final ValueFactory VALUES = SimpleValueFactory.getInstance();
    private static final IRI S = VALUES.createIRI("urn:s");
    private static final IRI P = VALUES.createIRI("urn:p");
    private static final String DOCUMENT = "<urn:s> <urn:p> \"a\" .";

    private final String url;
    private final SPARQLRepository repository;
    private int counter;

    private Rdf4jConnection(String url) {
        this.url = url;
        repository = new SPARQLRepository(url + "sparql", url + "sparql");
    }

    static void run(String url) {
        new Rdf4jConnection(url).run(new Checks("Rdf4jConnection"));
    }

    /** What is done with a connection. */
    private interface Task {
        void run(RepositoryConnection connection) throws Exception;
    }

    private Checks.Check with(Task task) {
        return () -> {
            try (RepositoryConnection connection = Calls.noted(RepositoryConnection.class,
                repository.getConnection())) {
                task.run(connection);
            }
        };
    }

    private IRI fresh() {
        return VALUES.createIRI(url + "data/rdf4j/c" + ++counter);
    }

    private IRI with(RepositoryConnection connection, String... values) {
        IRI graph = fresh();
        for (String value : values) connection.add(S, P, VALUES.createLiteral(value), graph);
        return graph;
    }

    private static void holds(RepositoryConnection connection, IRI graph, String... values) {
        Set<String> found = new TreeSet<>();
        try (RepositoryResult<Statement> statements = connection.getStatements(S, P, null, graph)) {
            statements.forEach(each -> found.add(each.getObject().stringValue()));
        }
        Checks.equal(new TreeSet<>(List.of(values)), found);
    }

    private void run(Checks checks) {
        queries(checks);
        reading(checks);
        adding(checks);
        removing(checks);
        transactions(checks);
        repositories(checks);
    }

    private void queries(Checks checks) {
        checks.check("queries with a base", with(connection -> {
            IRI graph = with(connection, "a");
            String name = graph.stringValue().substring(url.length());
            Checks.yes(connection.prepareBooleanQuery(QueryLanguage.SPARQL, "ASK { GRAPH <" + name
                + "> { ?s ?p 'a' } }", url).evaluate(), "false");
        }));
        checks.check("queries of each form, by their language", with(connection -> {
            IRI graph = with(connection, "a");
            String where = "{ GRAPH <" + graph + "> { ?s <urn:p> ?o } }";
            for (TupleQuery query : List.of(connection.prepareTupleQuery(QueryLanguage.SPARQL, "SELECT ?o " + where),
                connection.prepareTupleQuery(QueryLanguage.SPARQL, "SELECT ?o " + where, url),
                (TupleQuery) connection.prepareQuery(QueryLanguage.SPARQL, "SELECT ?o " + where)))
                Checks.equal("a", QueryResults.asList(query.evaluate()).get(0).getValue("o").stringValue());
            String construct = "CONSTRUCT { ?s ?p ?o } WHERE { GRAPH <" + graph + "> { ?s ?p ?o FILTER(?p = <urn:p>) } }";
            for (GraphQuery query : List.of(connection.prepareGraphQuery(QueryLanguage.SPARQL, construct),
                connection.prepareGraphQuery(QueryLanguage.SPARQL, construct, url),
                (GraphQuery) connection.prepareQuery(QueryLanguage.SPARQL, construct, url)))
                Checks.equal(1, QueryResults.asModel(query.evaluate()).size());
            Checks.yes(connection.prepareBooleanQuery(QueryLanguage.SPARQL, "ASK " + where).evaluate(), "false");
            IRI other = fresh();
            connection.prepareUpdate(QueryLanguage.SPARQL, "INSERT DATA { GRAPH <" + other
                + "> { <urn:s> <urn:p> 'b' } }").execute();
            holds(connection, other, "b");
        }));
        checks.check("an update with a base", with(connection -> {
            IRI graph = fresh();
            String name = graph.stringValue().substring(url.length());
            connection.prepareUpdate(QueryLanguage.SPARQL, "INSERT DATA { GRAPH <" + name
                + "> { <urn:s> <urn:p> 'a' } }", url).execute();
            holds(connection, graph, "a");
        }));
        checks.check("prepareGraphQuery with bindings", with(connection -> {
            IRI graph = with(connection, "a", "b");
            GraphQuery query = connection.prepareGraphQuery("CONSTRUCT { ?s ?p ?o } WHERE { GRAPH ?g { ?s ?p ?o } }");
            query.setBinding("g", graph);
            query.setBinding("p", P);
            query.setBinding("o", VALUES.createLiteral("b"));
            Checks.equal(1, QueryResults.asModel(query.evaluate()).size());
        }));
        checks.check("prepareUpdate with a dataset of named graphs", with(connection -> {
            IRI from = with(connection, "a");
            IRI to = fresh();
            SimpleDataset dataset = new SimpleDataset();
            dataset.addNamedGraph(from);
            Update update = connection.prepareUpdate("INSERT { GRAPH <" + to
                + "> { ?s <urn:p> ?o } } WHERE { GRAPH ?g { ?s <urn:p> ?o } }");
            update.setDataset(dataset);
            update.execute();
            holds(connection, to, "a");
        }));
    }

    private void reading(Checks checks) {
        checks.check("getStatements of several graphs", with(connection -> {
            IRI one = with(connection, "a");
            IRI two = with(connection, "b");
            Checks.equal(2, QueryResults.asList(connection.getStatements(S, P, null, false, one, two)).size());
        }));
        checks.check("hasStatement of a statement, of several graphs, of the union", with(connection -> {
            IRI one = with(connection, "only one");
            IRI two = with(connection, "b");
            Value value = VALUES.createLiteral("only one");
            Checks.yes(connection.hasStatement(VALUES.createStatement(S, P, value), false, one), "not there");
            Checks.yes(connection.hasStatement(S, P, value, false, two, one), "not in one of them");
            Checks.yes(connection.hasStatement(S, P, value, false), "not in the union");
            Checks.yes(!connection.hasStatement(S, P, value, false, two), "there");
        }));
        checks.check("size of graphs, which RDF4J counts in quad mode alone", () -> {
            SPARQLRepository quads = new SPARQLRepository(url + "sparql", url + "sparql");
            quads.enableQuadMode(true);
            try (RepositoryConnection connection = quads.getConnection()) {
                IRI one = with(connection, "a", "b");
                IRI two = with(connection, "c");
                Checks.equal(connection.size(two) + 1, connection.size(one));
                Checks.equal(connection.size(one) + connection.size(two), connection.size(one, two));
            }
        });
        checks.check("export of several graphs, exportStatements of the union", with(connection -> {
            IRI one = with(connection, "exported");
            IRI two = with(connection, "b");
            StatementCollector found = new StatementCollector();
            connection.export(found, one, two);
            Checks.equal(2L, found.getStatements().stream().filter(each -> each.getPredicate().equals(P)).count());
            StatementCollector all = new StatementCollector();
            connection.exportStatements(S, P, VALUES.createLiteral("exported"), false, all);
            Checks.equal(1, all.getStatements().size());
        }));
        checks.check("export of everything", with(connection -> {
            StatementCollector found = new StatementCollector();
            connection.export(found);
            Checks.yes(found.getStatements().size() > 500, found.getStatements().size());
        }));
        checks.check("namespaces, which SPARQL has none of", with(connection -> {
            Checks.equal(0, QueryResults.asList(connection.getNamespaces()).size());
            Checks.equal(null, connection.getNamespace("rdf"));
            connection.setNamespace("u", "urn:");
            connection.removeNamespace("u");
            connection.clearNamespaces();
            Checks.equal(null, connection.getNamespace("u"));
        }));
    }

    private static File file() throws Exception {
        File file = File.createTempFile("interop", ".ttl");
        file.deleteOnExit();
        Files.writeString(file.toPath(), DOCUMENT);
        return file;
    }

    private static InputStream stream() {
        return new ByteArrayInputStream(DOCUMENT.getBytes(StandardCharsets.UTF_8));
    }

    private void adding(Checks checks) {
        checks.check("add of streams, readers and files", with(connection -> {
            for (Task task : List.<Task>of(
                each -> each.add(stream(), RDFFormat.TURTLE, last()),
                each -> each.add(stream(), "", RDFFormat.TURTLE, last()),
                each -> each.add(new StringReader(DOCUMENT), RDFFormat.TURTLE, last()),
                each -> each.add(file(), last()), each -> each.add(file(), RDFFormat.TURTLE, last()),
                each -> each.add(file(), "urn:base", RDFFormat.TURTLE, last()))) {
                fresh();
                task.run(connection);
                holds(connection, last(), "a");
            }
        }));
        checks.check("add of a page by its URL and syntax", with(connection -> {
            IRI graph = fresh();
            connection.add(URI.create(url + "nodes/aircraft").toURL(), RDFFormat.TURTLE, graph);
            connection.add(URI.create(url + "data/rdf4j/").toURL(), "urn:base", RDFFormat.TURTLE, graph);
            for (String name : List.of("nodes/aircraft", "data/rdf4j/"))
                Checks.yes(connection.hasStatement(VALUES.createIRI(url + name), null, null, false, graph), name);
        }));
        checks.check("add of a statement that names its graph", with(connection -> {
            IRI graph = fresh();
            connection.add(VALUES.createStatement(S, P, VALUES.createLiteral("a"), graph));
            connection.add(List.of(VALUES.createStatement(S, P, VALUES.createLiteral("b"), graph)));
            holds(connection, graph, "a", "b");
        }));
        checks.check("add to several graphs", with(connection -> {
            IRI one = fresh();
            IRI two = fresh();
            connection.add(VALUES.createStatement(S, P, VALUES.createLiteral("a")), one, two);
            holds(connection, one, "a");
            holds(connection, two, "a");
        }));
        checks.check("add and remove of the statements of another graph", with(connection -> {
            IRI from = with(connection, "a", "b");
            IRI to = fresh();
            try (RepositoryResult<Statement> found = connection.getStatements(S, P, null, from)) {
                connection.add(found, to);
            }
            holds(connection, to, "a", "b");
            try (RepositoryResult<Statement> found = connection.getStatements(S, P, VALUES.createLiteral("a"), from)) {
                connection.remove(found, to);
            }
            holds(connection, to, "b");
        }));
        checks.check("add and remove of an iteration", with(connection -> {
            IRI graph = with(connection, "a", "b");
            IRI to = fresh();
            for (String value : List.of("a", "b"))
                try (CloseableIteration<Statement> found = connection.getStatements(S, P, VALUES.createLiteral(value),
                    graph)) {
                    connection.add(found, to);
                }
            holds(connection, to, "a", "b");
            try (CloseableIteration<Statement> found = connection.getStatements(S, P, VALUES.createLiteral("b"), graph)) {
                connection.remove(found, to);
            }
            holds(connection, to, "a");
        }));
        checks.check("add without a graph adds to the default document", with(connection -> {
            connection.add(S, P, VALUES.createLiteral("in the default graph"));
            holds(connection, VALUES.createIRI(url + "data/default"), "in the default graph");
        }));
    }

    private IRI last() {
        return VALUES.createIRI(url + "data/rdf4j/c" + counter);
    }

    private void removing(Checks checks) {
        checks.check("remove of a statement that names its graph", with(connection -> {
            IRI graph = with(connection, "a", "b");
            connection.remove(VALUES.createStatement(S, P, VALUES.createLiteral("a"), graph));
            holds(connection, graph, "b");
        }));
        checks.check("remove from several graphs", with(connection -> {
            IRI one = with(connection, "a", "b");
            IRI two = with(connection, "a");
            connection.remove(S, P, VALUES.createLiteral("a"), one, two);
            holds(connection, one, "b");
            holds(connection, two);
        }));
        checks.check("clear of several graphs", with(connection -> {
            IRI one = with(connection, "a");
            IRI two = with(connection, "b");
            connection.clear(one, two);
            holds(connection, one);
            holds(connection, two);
        }));
        checks.check("clear of everything clears the documents", with(connection -> {
            IRI graph = with(connection, "a");
            connection.clear();
            holds(connection, graph);
        }));
        checks.check("clear of the default graph clears the default document alone", with(connection -> {
            IRI graph = with(connection, "a");
            connection.add(S, P, VALUES.createLiteral("b"));
            connection.clear((Resource) null);
            holds(connection, graph, "a");
            holds(connection, VALUES.createIRI(url + "data/default"));
        }));
    }

    private void transactions(Checks checks) {
        checks.check("begin of an isolation level, isActive, commit", with(connection -> {
            IRI graph = with(connection, "a");
            connection.begin(IsolationLevels.NONE);
            Checks.yes(connection.isActive(), "not active");
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            connection.commit();
            Checks.yes(!connection.isActive(), "active");
            holds(connection, graph, "a", "b");
        }));
        checks.check("begin with settings, commit in one phase", with(connection -> {
            IRI graph = with(connection, "a");
            connection.setIsolationLevel(IsolationLevels.NONE);
            Checks.equal(IsolationLevels.NONE, connection.getIsolationLevel());
            connection.begin(new TransactionSetting[0]);
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            Checks.fails(UnsupportedOperationException.class, "2-phase", connection::prepare);
            connection.commit();
            holds(connection, graph, "a", "b");
        }));
        checks.check("setAutoCommit", with(connection -> setAutoCommit(connection)));
        checks.check("a commit that is refused writes nothing", with(connection -> {
            IRI graph = with(connection, "a");
            connection.begin();
            connection.add(S, P, VALUES.createLiteral("b"), graph);
            connection.add(S, P, VALUES.createLiteral("b"), VALUES.createIRI(url + "topics/aircraft/engine/speed"));
            Checks.fails(RepositoryException.class, "", connection::commit);
            holds(connection, graph, "a");
        }));
    }

    @SuppressWarnings("deprecation")
    private void setAutoCommit(RepositoryConnection connection) {
        IRI graph = with(connection, "a");
        connection.setAutoCommit(false);
        Checks.yes(!connection.isAutoCommit(), "still");
        connection.add(S, P, VALUES.createLiteral("b"), graph);
        connection.setAutoCommit(true);
        holds(connection, graph, "a", "b");
    }

    private void repositories(Checks checks) {
        checks.check("a repository of one endpoint, with headers", () -> {
            SPARQLRepository one = new SPARQLRepository(url + "sparql");
            one.setAdditionalHttpHeaders(Map.of("Cache-Control", "no-cache"));
            try (RepositoryConnection connection = Calls.noted(RepositoryConnection.class, one.getConnection())) {
                Checks.yes(connection.isOpen() && !connection.isEmpty(), "empty");
                connection.setParserConfig(connection.getParserConfig());
                Checks.equal(connection.getRepository(), one);
                Checks.equal(P, connection.getValueFactory().createIRI(P.stringValue()));
            } finally {
                one.shutDown();
            }
        });
    }
}
