import java.net.http.HttpClient;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.List;
import org.apache.jena.atlas.web.HttpException;
import org.apache.jena.graph.Graph;
import org.apache.jena.graph.Node;
import org.apache.jena.graph.NodeFactory;
import org.apache.jena.query.Dataset;
import org.apache.jena.query.DatasetFactory;
import org.apache.jena.query.Query;
import org.apache.jena.query.QueryFactory;
import org.apache.jena.query.ReadWrite;
import org.apache.jena.query.TxnType;
import org.apache.jena.rdfconnection.RDFConnection;
import org.apache.jena.rdflink.RDFLink;
import org.apache.jena.rdflink.RDFLinkHTTP;
import org.apache.jena.riot.RDFFormat;
import org.apache.jena.riot.WebContent;
import org.apache.jena.sparql.core.DatasetGraph;
import org.apache.jena.sparql.core.DatasetGraphFactory;
import org.apache.jena.sparql.exec.QueryExec;
import org.apache.jena.sparql.exec.http.DSP;
import org.apache.jena.sparql.exec.http.QueryExecutionHTTP;
import org.apache.jena.sparql.exec.http.UpdateExecutionHTTP;
import org.apache.jena.sparql.graph.GraphFactory;
import org.apache.jena.system.Txn;
import org.apache.jena.update.UpdateFactory;

/** Jena's RDFLink, calls of RDFConnection for whole datasets, its transactions, builders and headers. */
final class JenaLink {
    private static final Node S = NodeFactory.createURI("urn:s");
    private static final Node P = NodeFactory.createURI("urn:p");

    private final String url;
    private int counter;

    private JenaLink(String url) {
        this.url = url;
    }

    static void run(String url) {
        new JenaLink(url).run(new Checks("JenaLink"));
    }

    private RDFLink link() {
        return Calls.noted(RDFLink.class, RDFLinkHTTP.newBuilder().destination(url)
            .queryEndpoint("sparql").updateEndpoint("sparql").gspEndpoint("graphs").build());
    }

    /** One whose graph store is asked for all graphs. */
    private RDFConnection datasets() {
        return Calls.noted(RDFConnection.class, JenaQuery.builder(url).gspEndpoint("graphs?all").build());
    }

    private Node fresh() {
        return NodeFactory.createURI(url + "data/jena/linked" + ++counter);
    }

    private static Graph graph(String... values) {
        Graph graph = GraphFactory.createDefaultGraph();
        for (String value : values) graph.add(S, P, NodeFactory.createLiteralString(value));
        return graph;
    }

    private static Path file(String ending, String text) throws Exception {
        Path path = Files.createTempFile("interop", ending);
        path.toFile().deleteOnExit();
        return Files.writeString(path, text);
    }

    private static void holds(Graph found, String... values) {
        List<String> read = new ArrayList<>();
        found.find(S, P, Node.ANY).forEachRemaining(triple -> read.add(triple.getObject().getLiteralLexicalForm()));
        Checks.equal(List.of(values), read.stream().sorted().toList());
    }

    private static String construct(Node graph) {
        return "CONSTRUCT { ?s ?p ?o } WHERE { GRAPH <" + graph.getURI() + "> { ?s ?p ?o . FILTER(?p = <urn:p>) } }";
    }

    private static String ask(Node graph) {
        return "ASK { GRAPH <" + graph.getURI() + "> { <urn:s> <urn:p> 'a' } }";
    }

    private static String insert(Node graph) {
        return "INSERT DATA { GRAPH <" + graph.getURI() + "> { <urn:s> <urn:p> 'a' } }";
    }

    private void run(Checks checks) {
        queries(checks);
        parsed(checks);
        graphs(checks);
        datasets(checks);
        transactions(checks);
        builders(checks);
    }

    private void queries(Checks checks) {
        checks.check("queryRowSet, querySelect, queryAsk, queryConstruct, queryDescribe", () -> {
            Node graph = fresh();
            String select = "SELECT ?o { GRAPH <" + graph.getURI() + "> { <urn:s> <urn:p> ?o } }";
            try (RDFLink link = link()) {
                link.update(insert(graph));
                link.queryRowSet(select, rows -> Checks.equal("a", rows.next().get("o").getLiteralLexicalForm()));
                List<String> seen = new ArrayList<>();
                link.querySelect(select, row -> seen.add(row.get("o").getLiteralLexicalForm()));
                Checks.equal(List.of("a"), seen);
                Checks.yes(link.queryAsk(ask(graph)), "false");
                holds(link.queryConstruct(construct(graph)), "a");
                Checks.yes(!link.queryDescribe("DESCRIBE <urn:s>").isEmpty(), "nothing");
            }
        });
        checks.check("query, newQuery, newUpdate", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.newUpdate().update(insert(graph)).execute();
                try (QueryExec execution = link.query(ask(graph))) {
                    Checks.yes(execution.ask(), "false");
                }
                try (QueryExec execution = link.newQuery().query(ask(graph).replace("'a'", "?o"))
                    .substitution("o", NodeFactory.createLiteralString("z")).build()) {
                    Checks.yes(!execution.ask(), "true");
                }
            }
        });
    }

    private void parsed(Checks checks) {
        checks.check("queries that were parsed before", () -> {
            Node graph = fresh();
            Query select = QueryFactory.create("SELECT ?o { GRAPH <" + graph.getURI() + "> { <urn:s> <urn:p> ?o } }");
            try (RDFLink link = link()) {
                link.update(UpdateFactory.create(insert(graph)));
                link.queryRowSet(select, rows -> Checks.equal("a", rows.next().get("o").getLiteralLexicalForm()));
                link.querySelect(select, row -> Checks.equal("a", row.get("o").getLiteralLexicalForm()));
                Checks.yes(link.queryAsk(QueryFactory.create(ask(graph))), "false");
                holds(link.queryConstruct(QueryFactory.create(construct(graph))), "a");
                Checks.yes(!link.queryDescribe(QueryFactory.create("DESCRIBE <urn:s>")).isEmpty(), "nothing");
                try (QueryExec execution = link.query(select)) {
                    Checks.yes(execution.select().hasNext(), "nothing");
                }
            }
        });
        checks.check("an update of one operation", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.update(UpdateFactory.create(insert(graph)).getOperations().get(0));
                Checks.yes(link.isRemote() && !link.isClosed() && link.queryAsk(ask(graph)), "false");
            }
        });
        checks.check("queryConstructDataset, of triples in the default graph", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.update(insert(graph));
                holds(link.queryConstructDataset(construct(graph)).getDefaultGraph(), "a");
                holds(link.queryConstructDataset(QueryFactory.create(construct(graph))).getDefaultGraph(), "a");
            }
        });
    }

    private void graphs(Checks checks) {
        checks.check("put, load, get, delete of a graph", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.put(graph, graph("a"));
                link.load(graph, graph("b"));
                holds(link.get(graph), "a", "b");
                holds(link.get(graph.getURI()), "a", "b");
                link.delete(graph);
                Checks.fails(HttpException.class, "4", () -> link.get(graph));
            }
        });
        checks.check("put and load of files", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.put(graph, file(".ttl", "<urn:s> <urn:p> 'a' .").toString());
                link.load(graph, file(".nt", "<urn:s> <urn:p> \"b\" .").toString());
                holds(link.get(graph), "a", "b");
            }
        });
        checks.check("get of the default graph", () -> {
            try (RDFLink link = link()) {
                Checks.yes(link.get().size() > 500, "too small");
            }
        });
        checks.check("a link writes the default document for the default graph", () -> {
            String path = file(".ttl", "<urn:s> <urn:p> 'default' .").toString();
            String asked = "ASK { GRAPH <" + url + "data/default> { <urn:s> <urn:p> 'default' } }";
            try (RDFLink link = link()) {
                for (Checks.Check write : List.<Checks.Check>of(() -> link.put(path), () -> link.load(path),
                    () -> link.put(graph("default")), () -> link.load(graph("default"))))
                    write.run();
                link.put(path);
                Checks.yes(link.queryAsk(asked), "not written");
                link.delete();
                Checks.yes(!link.queryAsk(asked), "not deleted");
            }
        });
        checks.check("files are written to the default graph", () -> {
            String path = file(".ttl", "<urn:s> <urn:p> 'default' .").toString();
            try (RDFConnection connection = JenaQuery.connection(url)) {
                connection.put(path);
                connection.load(path);
                Checks.yes(connection.queryAsk("ASK { ?s <urn:p> 'default' }"), "not written");
                connection.delete();
            }
        });
    }

    private Dataset dataset(Node graph, String... values) {
        DatasetGraph dataset = DatasetGraphFactory.create();
        dataset.addGraph(graph, graph(values));
        return DatasetFactory.wrap(dataset);
    }

    private void datasets(Checks checks) {
        checks.check("putDataset, loadDataset, fetchDataset", () -> {
            Node graph = fresh();
            try (RDFConnection connection = datasets()) {
                connection.putDataset(dataset(graph, "a"));
                connection.loadDataset(dataset(graph, "b"));
                holds(connection.fetchDataset().asDatasetGraph().getGraph(graph), "a", "b");
                connection.putDataset(dataset(graph, "c"));
                holds(connection.fetchDataset().asDatasetGraph().getGraph(graph), "c");
            }
        });
        checks.check("putDataset, loadDataset, getDataset of a link", () -> {
            Node graph = fresh();
            String quads = "<urn:s> <urn:p> \"c\" <" + graph.getURI() + "> .\n";
            try (RDFLink link = Calls.noted(RDFLink.class, RDFLinkHTTP.newBuilder().destination(url)
                .queryEndpoint("sparql").updateEndpoint("sparql").gspEndpoint("graphs?all").build())) {
                link.putDataset(dataset(graph, "a").asDatasetGraph());
                link.loadDataset(dataset(graph, "b").asDatasetGraph());
                holds(link.getDataset().getGraph(graph), "a", "b");
                link.putDataset(file(".nq", quads).toString());
                link.loadDataset(file(".nq", quads.replace("c", "d")).toString());
                holds(link.getDataset().getGraph(graph), "c", "d");
            }
        });
        checks.check("putDataset and loadDataset of files", () -> {
            Node graph = fresh();
            String trig = "<" + graph.getURI() + "> { <urn:s> <urn:p> 'a' }";
            String quads = "<urn:s> <urn:p> \"b\" <" + graph.getURI() + "> .\n";
            try (RDFConnection connection = datasets()) {
                connection.putDataset(file(".trig", trig).toString());
                connection.loadDataset(file(".nq", quads).toString());
                holds(connection.fetchDataset().asDatasetGraph().getGraph(graph), "a", "b");
            }
        });
        checks.check("datasets as N-Quads", () -> {
            Node graph = fresh();
            try (RDFConnection connection = JenaQuery.builder(url).gspEndpoint("graphs?all")
                .quadsFormat(RDFFormat.NQUADS).acceptHeaderDataset(WebContent.contentTypeNQuads).build()) {
                connection.putDataset(dataset(graph, "a"));
                holds(connection.fetchDataset().asDatasetGraph().getGraph(graph), "a");
            }
        });
        checks.check("DSP PUT, POST, GET", () -> {
            Node graph = fresh();
            DSP.service(url + "graphs?all").PUT(dataset(graph, "a").asDatasetGraph());
            DSP.service(url + "graphs?all").POST(dataset(graph, "b").asDatasetGraph());
            holds(DSP.service(url + "graphs?all").GET().getGraph(graph), "a", "b");
        });
        checks.check("clearDataset clears the documents", () -> {
            Node graph = fresh();
            try (RDFLink link = link()) {
                link.put(graph, graph("a"));
                link.clearDataset();
                holds(link.get(graph));
            }
        });
    }

    private void transactions(Checks checks) {
        checks.check("begin, update, commit", () -> {
            Node graph = fresh();
            try (RDFConnection connection = JenaQuery.connection(url)) {
                connection.begin(ReadWrite.WRITE);
                Checks.yes(connection.isInTransaction(), "none");
                connection.update(insert(graph));
                connection.commit();
                connection.end();
                Checks.yes(connection.queryAsk(ask(graph)), "false");
            }
        });
        checks.check("a transaction that reads", () -> {
            try (RDFConnection connection = JenaQuery.connection(url)) {
                Checks.yes(Txn.calculateRead(connection, () -> connection.queryAsk("ASK { ?s ?p ?o }")), "false");
                connection.begin(TxnType.READ);
                Checks.yes(connection.fetch().size() > 500, "too small");
                connection.end();
            }
        });
    }

    private void builders(Checks checks) {
        checks.check("connect to the SPARQL endpoint alone", () -> {
            Node graph = fresh();
            try (RDFConnection connection = RDFConnection.connect(url + "sparql")) {
                connection.update(insert(graph));
                Checks.yes(connection.queryAsk(ask(graph)), "false");
                Checks.fails(HttpException.class, "4", () -> connection.fetch(graph.getURI()));
                Checks.yes(!connection.isClosed(), "closed");
            }
        });
        checks.check("queryConnect", () -> {
            try (RDFConnection connection = RDFConnection.queryConnect(url + "sparql")) {
                Checks.yes(connection.queryAsk("ASK {}"), "false");
            }
        });
        checks.check("an HTTP client of HTTP/1.1", () -> {
            Node graph = fresh();
            HttpClient client = HttpClient.newBuilder().version(HttpClient.Version.HTTP_1_1).build();
            try (RDFConnection connection = JenaQuery.builder(url).httpClient(client).build()) {
                connection.update(insert(graph));
                holds(connection.fetch(graph.getURI()).getGraph(), "a");
            }
        });
        checks.check("headers of a query and of an update", () -> {
            Node graph = fresh();
            UpdateExecutionHTTP.service(url + "sparql").httpHeader("Prefer", "return=minimal").update(insert(graph))
                .execute();
            try (QueryExecutionHTTP execution = QueryExecutionHTTP.service(url + "sparql").queryString(ask(graph))
                .httpHeader("Cache-Control", "no-cache").acceptHeader(WebContent.contentTypeResultsXML).build()) {
                Checks.yes(execution.execAsk(), "false");
            }
        });
    }
}
