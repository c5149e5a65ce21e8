import java.io.ByteArrayOutputStream;
import java.io.InputStream;
import java.net.HttpURLConnection;
import java.net.URI;
import org.eclipse.rdf4j.model.Model;
import org.eclipse.rdf4j.model.ValueFactory;
import org.eclipse.rdf4j.model.impl.LinkedHashModel;
import org.eclipse.rdf4j.model.impl.SimpleValueFactory;
import org.eclipse.rdf4j.rio.RDFFormat;
import org.eclipse.rdf4j.rio.Rio;

/** RDF4J's Rio over the JDK's older HttpURLConnection: it reads pages and writes graphs in each syntax. */
final class Rdf4jRio {
    private static final String[] PAGES = {
        "", "topics/", "topics/aircraft/engine/speed", "nodes/", "services/aircraft/start", "parameters/",
            "parameters/cockpit/night",
        "resources/", "resources/aircraft/", "resources/aircraft/power", "mappings/", "data/", "queries/",
            "queries/inventory", "sparql",
        "ontology", "shapes/limits", "shapes/mapping", "shapes/std_msgs/msg/String", "types/std_msgs/msg/String",
            "calls/", "bags/",
    };

    private final String url;
    private int counter;

    private Rdf4jRio(String url) {
        this.url = url;
    }

    static void run(String url) {
        new Rdf4jRio(url).run(new Checks("Rdf4jRio"));
    }

    private void run(Checks checks) {
        checks.check("pages as Turtle", () -> pages(RDFFormat.TURTLE, false));
        checks.check("pages as N-Triples", () -> pages(RDFFormat.NTRIPLES, false));
        checks.check("pages as RDF/XML", () -> pages(RDFFormat.RDFXML, false));
        checks.check("pages as JSON-LD", () -> pages(RDFFormat.JSONLD, false));
        checks.check("pages as N-Quads, in the default graph", () -> pages(RDFFormat.NQUADS, true));
        checks.check("pages as TriG, in the default graph", () -> pages(RDFFormat.TRIG, true));
        checks.check("a graph is written as Turtle", () -> written(RDFFormat.TURTLE));
        checks.check("a graph is written as N-Triples", () -> written(RDFFormat.NTRIPLES));
        checks.check("a graph is written as RDF/XML", () -> written(RDFFormat.RDFXML));
        checks.check("a graph is written as JSON-LD", () -> written(RDFFormat.JSONLD));
        checks.check("a graph is written as N-Quads", () -> written(RDFFormat.NQUADS));
        checks.check("a graph is written as TriG", () -> written(RDFFormat.TRIG));
    }

    private static Model read(String url, RDFFormat format) throws Exception {
        HttpURLConnection connection = (HttpURLConnection) URI.create(url).toURL().openConnection();
        connection.setRequestProperty("Accept", format.getDefaultMIMEType());
        try (InputStream body = connection.getInputStream()) {
            return Rio.parse(body, url, format);
        }
    }

    private void pages(RDFFormat format, boolean quads) {
        StringBuilder failed = new StringBuilder();
        for (String path : PAGES) {
            try {
                Model found = read(url + path, format);
                Checks.yes(!found.isEmpty(), "no triples");
                Checks.yes(!quads || !found.filter(null, null, null, (org.eclipse.rdf4j.model.Resource) null).isEmpty(),
                    "nothing in the default graph");
            } catch (Exception | AssertionError error) {
                failed.append('/').append(path).append(": ").append(error).append('\n');
            }
        }
        Checks.equal("", failed.toString());
    }

    private void written(RDFFormat format) throws Exception {
        String graph = url + "data/rio/g" + ++counter;
        ValueFactory values = SimpleValueFactory.getInstance();
        Model model = new LinkedHashModel();
        model.add(values.createIRI("urn:s"), values.createIRI("urn:p"), values.createLiteral("\u00e4\n\"", "de"));
        model.add(values.createIRI("urn:s"), values.createIRI("urn:p"), values.createBNode());
        ByteArrayOutputStream bytes = new ByteArrayOutputStream();
        Rio.write(model, bytes, format);
        HttpURLConnection connection = (HttpURLConnection) URI.create(graph).toURL().openConnection();
        connection.setRequestMethod("PUT");
        connection.setDoOutput(true);
        connection.setRequestProperty("Content-Type", format.getDefaultMIMEType());
        connection.getOutputStream().write(bytes.toByteArray());
        Checks.equal(201, connection.getResponseCode());
        Model found = read(graph, format);
        Checks.equal(2, found.filter(null, values.createIRI("urn:p"), null).size());
        Checks.yes(found.contains(null, null, values.createLiteral("\u00e4\n\"", "de")), found);
    }
}
