import java.nio.file.Files;
import java.nio.file.Path;
import org.apache.jena.atlas.web.HttpException;
import org.apache.jena.graph.Graph;
import org.apache.jena.rdf.model.Model;
import org.apache.jena.rdf.model.ModelFactory;
import org.apache.jena.rdf.model.ResourceFactory;
import org.apache.jena.rdfconnection.RDFConnection;
import org.apache.jena.riot.Lang;
import org.apache.jena.riot.RDFDataMgr;
import org.apache.jena.riot.RDFFormat;
import org.apache.jena.riot.RDFParser;
import org.apache.jena.riot.WebContent;
import org.apache.jena.sparql.core.DatasetGraph;
import org.apache.jena.sparql.exec.http.GSP;
import org.apache.jena.http.HttpRDF;

/** Jena's RDFConnection, GSP and HttpRDF: the graph store, graphs by their own URLs, pages as documents. */
final class JenaGraphStore {
    private final String url;
    private int counter;

    private JenaGraphStore(String url) {
        this.url = url;
    }

    static void run(String url) {
        new JenaGraphStore(url).run(new Checks("JenaGraphStore"));
    }

    private RDFConnection connection() {
        return JenaQuery.connection(url);
    }

    private String fresh() {
        return url + "data/jena/stored" + ++counter;
    }

    private static Model model(String... values) {
        Model model = ModelFactory.createDefaultModel();
        for (String value : values)
            model.add(ResourceFactory.createResource("http://example.org/s"),
                ResourceFactory.createProperty("http://example.org/p"), value);
        return model;
    }

    private static Path file(String ending, String text) throws Exception {
        Path path = Files.createTempFile("interop", ending);
        path.toFile().deleteOnExit();
        return Files.writeString(path, text);
    }

    private static void holds(Model found, String... values) {
        Checks.equal(model(values).listStatements().toSet(),
            found.listStatements(null, ResourceFactory.createProperty("http://example.org/p"), (String) null).toSet());
    }

    private void run(Checks checks) {
        calls(checks);
        again(checks);
        files(checks);
        formats(checks);
        protocol(checks);
        direct(checks);
        pages(checks);
    }

    private void calls(Checks checks) {
        checks.check("put of a model, then fetch", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a", "\u00e4\n\""));
                holds(connection.fetch(graph), "a", "\u00e4\n\"");
            }
        });
        checks.check("put replaces", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.put(graph, model("b"));
                holds(connection.fetch(graph), "b");
            }
        });
        checks.check("load into a graph that exists merges", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.load(graph, model("b"));
                holds(connection.fetch(graph), "a", "b");
            }
        });
        checks.check("load into a new graph makes it", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.load(graph, model("a"));
                holds(connection.fetch(graph), "a");
            }
        });
        checks.check("put of an empty model", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model());
                holds(connection.fetch(graph));
            }
        });
        checks.check("put of 20,000 triples", () -> {
            String graph = fresh();
            String[] values = new String[20_000];
            for (int i = 0; i < values.length; i++) values[i] = "v" + i;
            try (RDFConnection connection = connection()) {
                connection.put(graph, model(values));
                holds(connection.fetch(graph), values);
            }
        });
        checks.check("delete, then fetch", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.delete(graph);
                Checks.fails(HttpException.class, "4", () -> connection.fetch(graph));
            }
        });
        checks.check("fetch of a graph that does not exist", () -> {
            try (RDFConnection connection = connection()) {
                Checks.fails(HttpException.class, "404", () -> connection.fetch(fresh()));
            }
        });
        checks.check("delete of a graph that does not exist", () -> {
            try (RDFConnection connection = connection()) {
                Checks.fails(HttpException.class, "404", () -> connection.delete(fresh()));
            }
        });
        checks.check("fetch of the default graph", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.fetch().size() > 500, "too small");
            }
        });
        checks.check("fetch of a graph of the robot", () -> {
            try (RDFConnection connection = connection()) {
                Checks.yes(connection.fetch(url + "topics/aircraft/engine/speed").size() > 5, "too small");
            }
        });
        checks.check("what was put is queried, what was inserted is fetched", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                Checks.yes(connection.queryAsk("ASK { GRAPH <" + graph
                    + "> { <http://example.org/s> <http://example.org/p> 'a' } }"), "not queried");
                connection.update("INSERT DATA { GRAPH <" + graph
                    + "> { <http://example.org/s> <http://example.org/p> 'b' } }");
                holds(connection.fetch(graph), "a", "b");
            }
        });
    }

    private void again(Checks checks) {
        checks.check("put of what was fetched", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                Model found = connection.fetch(graph);
                found.add(model("b"));
                connection.put(graph, found);
                holds(connection.fetch(graph), "a", "b");
            }
        });
        checks.check("delete, then put", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.delete(graph);
                connection.put(graph, model("b"));
                holds(connection.fetch(graph), "b");
            }
        });
        checks.check("delete, then load", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.delete(graph);
                connection.load(graph, model("b"));
                holds(connection.fetch(graph), "b");
            }
        });
        checks.check("DROP, then put", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, model("a"));
                connection.update("DROP GRAPH <" + graph + ">");
                connection.put(graph, model("b"));
                holds(connection.fetch(graph), "b");
            }
        });
        checks.check("writes to the default graph go to the default document", () -> {
            String document = url + "data/default";
            try (RDFConnection connection = connection()) {
                connection.put(model("a"));
                holds(connection.fetch(document), "a");
                connection.load(model("b"));
                holds(connection.fetch(document), "a", "b");
                connection.delete();
                Checks.yes(!connection.isClosed(), "closed");
                Checks.fails(HttpException.class, "410", () -> connection.fetch(document));
            }
        });
    }

    private void loaded(String ending, String text) throws Exception {
        String graph = fresh();
        try (RDFConnection connection = connection()) {
            connection.load(graph, file(ending, text).toString());
            holds(connection.fetch(graph), "a");
        }
    }

    private void files(Checks checks) {
        checks.check("put of a file", () -> {
            String graph = fresh();
            try (RDFConnection connection = connection()) {
                connection.put(graph, file(".ttl", "<http://example.org/s> <http://example.org/p> 'a' .").toString());
                holds(connection.fetch(graph), "a");
            }
        });
        checks.check("load of a file of Turtle", () -> loaded(".ttl",
            "<http://example.org/s> <http://example.org/p> 'a' ."));
        checks.check("load of a file of N-Triples", () -> loaded(".nt",
            "<http://example.org/s> <http://example.org/p> \"a\" ."));
        checks.check("load of a file of JSON-LD", () -> loaded(".jsonld",
            "{\"@id\": \"http://example.org/s\", \"http://example.org/p\": \"a\"}"));
        checks.check("load of a file of RDF/XML", () -> loaded(".rdf",
            "<rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#' xmlns:u='http://example.org/'>"
                + "<rdf:Description rdf:about='http://example.org/s'><u:p>a</u:p></rdf:Description></rdf:RDF>"));
    }

    private void put(RDFFormat format) {
        String graph = fresh();
        try (RDFConnection connection = JenaQuery.builder(url).triplesFormat(format).build()) {
            connection.put(graph, model("a", "\u00e4"));
            holds(connection.fetch(graph), "a", "\u00e4");
        }
    }

    private void fetched(String accepted) {
        String graph = fresh();
        try (RDFConnection connection = JenaQuery.builder(url).acceptHeaderGraph(accepted).build()) {
            connection.put(graph, model("a", "\u00e4"));
            holds(connection.fetch(graph), "a", "\u00e4");
        }
    }

    private void formats(Checks checks) {
        checks.check("put as Turtle", () -> put(RDFFormat.TURTLE));
        checks.check("put as N-Triples", () -> put(RDFFormat.NTRIPLES));
        checks.check("put as RDF/XML", () -> put(RDFFormat.RDFXML));
        checks.check("put as JSON-LD", () -> put(RDFFormat.JSONLD));
        checks.check("fetch as Turtle", () -> fetched(WebContent.contentTypeTurtle));
        checks.check("fetch as N-Triples", () -> fetched(WebContent.contentTypeNTriples));
        checks.check("fetch as RDF/XML", () -> fetched(WebContent.contentTypeRDFXML));
        checks.check("fetch as JSON-LD", () -> fetched(WebContent.contentTypeJSONLD));
        checks.check("fetch as N-Quads", () -> fetched(WebContent.contentTypeNQuads));
        checks.check("fetch as TriG", () -> fetched(WebContent.contentTypeTriG));
        checks.check("fetch of the default graph as RDF/XML", () -> {
            try (RDFConnection connection =
                JenaQuery.builder(url).acceptHeaderGraph(WebContent.contentTypeRDFXML).build()) {
                Checks.yes(connection.fetch().size() > 500, "too small");
            }
        });
    }

    private void protocol(Checks checks) {
        checks.check("GSP PUT, POST, GET, DELETE", () -> {
            String graph = fresh();
            GSP.service(url + "graphs").graphName(graph).PUT(model("a").getGraph());
            GSP.service(url + "graphs").graphName(graph).POST(model("b").getGraph());
            holds(ModelFactory.createModelForGraph(GSP.service(url + "graphs").graphName(graph).GET()), "a", "b");
            GSP.service(url + "graphs").graphName(graph).DELETE();
            Checks.fails(HttpException.class, "4", () -> GSP.service(url + "graphs").graphName(graph).GET());
        });
        checks.check("GSP GET of the default graph", () ->
            Checks.yes(GSP.service(url + "graphs").defaultGraph().GET().size() > 500, "too small"));
        checks.check("GSP PUT of a file with its syntax", () -> {
            String graph = fresh();
            GSP.service(url + "graphs").graphName(graph).contentType(RDFFormat.TURTLE).PUT(file(".x",
                "<http://example.org/s> <http://example.org/p> 'a' .").toString());
            holds(ModelFactory.createModelForGraph(GSP.service(url + "graphs").graphName(graph).GET()), "a");
        });
        checks.check("GSP names with letters of all kinds", () -> {
            String graph = url + "data/jena/\u00e4%20" + ++counter;
            GSP.service(url + "graphs").graphName(graph).PUT(model("a").getGraph());
            holds(ModelFactory.createModelForGraph(GSP.service(url + "graphs").graphName(graph).GET()), "a");
        });
    }

    private void direct(Checks checks) {
        checks.check("HttpRDF put, post, get, delete of a graph by its URL", () -> {
            String graph = fresh();
            HttpRDF.httpPutGraph(graph, model("a").getGraph());
            Graph found = HttpRDF.httpGetGraph(graph);
            holds(ModelFactory.createModelForGraph(found), "a");
            HttpRDF.httpDeleteGraph(graph);
            Checks.fails(HttpException.class, "4", () -> HttpRDF.httpGetGraph(graph));
        });
        checks.check("HttpRDF post of a graph to its URL", () -> {
            String graph = fresh();
            HttpRDF.httpPutGraph(graph, model("a").getGraph());
            HttpRDF.httpPostGraph(graph, model("b").getGraph());
            holds(ModelFactory.createModelForGraph(HttpRDF.httpGetGraph(graph)), "a", "b");
        });
    }

    private void pages(Checks checks) {
        checks.check("a page is read as a model", () -> {
            Model found = ModelFactory.createDefaultModel().read(url + "topics/aircraft/engine/speed");
            Checks.yes(found.size() > 5, found);
        });
        checks.check("a page is loaded as a model", () -> Checks.yes(RDFDataMgr.loadModel(url
            + "nodes/aircraft").size() > 3, "too small"));
        checks.check("a page is loaded as a dataset, into its default graph", () -> {
            DatasetGraph found = RDFParser.source(url + "topics/aircraft/engine/speed").toDatasetGraph();
            Checks.yes(found.getDefaultGraph().size() > 5, "the default graph has " + found.getDefaultGraph().size());
        });
        checks.check("pages as Turtle", () -> read(Lang.TURTLE));
        checks.check("pages as N-Triples", () -> read(Lang.NTRIPLES));
        checks.check("pages as RDF/XML", () -> read(Lang.RDFXML));
        checks.check("pages as JSON-LD", () -> read(Lang.JSONLD));
    }

    private static final String[] PAGES = {
        "", "topics/", "topics/aircraft/engine/speed", "nodes/", "services/aircraft/start", "parameters/",
            "parameters/cockpit/night",
        "resources/", "resources/aircraft/", "resources/aircraft/power", "mappings/", "data/", "queries/",
            "queries/inventory", "sparql",
        "ontology", "shapes/limits", "shapes/mapping", "shapes/std_msgs/msg/String", "types/std_msgs/msg/String",
            "calls/", "bags/",
    };

    private void read(Lang lang) {
        StringBuilder failed = new StringBuilder();
        for (String path : PAGES) {
            try {
                Graph found = RDFParser.source(url
                    + path).acceptHeader(lang.getContentType().getContentTypeStr()).toGraph();
                Checks.yes(found.size() > 0, "no triples");
            } catch (Exception | AssertionError error) {
                failed.append('/').append(path).append(": ").append(error).append('\n');
            }
        }
        Checks.equal("", failed.toString());
    }
}
