import java.util.ArrayList;
import java.util.List;
import java.util.concurrent.Future;
import java.util.concurrent.TimeUnit;
import org.apache.hc.client5.http.async.methods.SimpleHttpRequest;
import org.apache.hc.client5.http.async.methods.SimpleHttpResponse;
import org.apache.hc.client5.http.async.methods.SimpleRequestBuilder;
import org.apache.hc.client5.http.entity.UrlEncodedFormEntity;
import org.apache.hc.client5.http.entity.mime.MultipartEntityBuilder;
import org.apache.hc.client5.http.impl.async.CloseableHttpAsyncClient;
import org.apache.hc.client5.http.impl.async.HttpAsyncClients;
import org.apache.hc.client5.http.impl.classic.CloseableHttpClient;
import org.apache.hc.client5.http.impl.classic.HttpClients;
import org.apache.hc.core5.http.ClassicHttpRequest;
import org.apache.hc.core5.http.ContentType;
import org.apache.hc.core5.http.Header;
import org.apache.hc.core5.http.HttpEntity;
import org.apache.hc.core5.http.io.entity.EntityUtils;
import org.apache.hc.core5.http.io.entity.InputStreamEntity;
import org.apache.hc.core5.http.io.entity.StringEntity;
import org.apache.hc.core5.http.io.support.ClassicRequestBuilder;
import org.apache.hc.core5.http.message.BasicNameValuePair;

/** Apache's HttpClient: it offers an upgrade to TLS with each read, and states ISO-8859-1 unless told otherwise. */
final class ApacheHttpClient {
    private final String url;
    private final String folder;
    private int counter;

    /** What was answered. */
    private record Answer(int status, String body, String location, String tag) { }

    private ApacheHttpClient(String url) {
        this.url = url;
        folder = url + "data/apache/";
    }

    static void run(String url) {
        new ApacheHttpClient(url).run(new Checks("ApacheHttpClient"));
    }

    private String fresh() {
        return folder + "r" + ++counter;
    }

    private static Answer send(ClassicHttpRequest request) throws Exception {
        try (CloseableHttpClient client = HttpClients.createDefault()) {
            return send(client, request);
        }
    }

    private static Answer send(CloseableHttpClient client, ClassicHttpRequest request) throws Exception {
        return client.execute(request, answer -> {
            HttpEntity entity = answer.getEntity();
            return new Answer(answer.getCode(), entity == null ? "" : EntityUtils.toString(entity),
                value(answer.getFirstHeader("Location")), value(answer.getFirstHeader("ETag")));
        });
    }

    private static String value(Header header) {
        return header == null ? null : header.getValue();
    }

    private static Answer expect(int status, ClassicHttpRequest request) throws Exception {
        Answer answer = send(request);
        Checks.yes(answer.status == status, answer.toString());
        return answer;
    }

    private static Answer put(int status, String url, HttpEntity entity) throws Exception {
        return expect(status, ClassicRequestBuilder.put(url).setEntity(entity).build());
    }

    private static String read(String url) throws Exception {
        return expect(200, ClassicRequestBuilder.get(url).setHeader("Accept", "text/turtle").build()).body;
    }

    private void run(Checks checks) {
        charsets(checks);
        forms(checks);
        rest(checks);
    }

    private void charsets(Checks checks) {
        checks.check("Turtle in ISO-8859-1, as it is stated by default", () -> {
            String graph = fresh();
            put(201, graph, new StringEntity("<urn:s> <urn:p> 'b\u00e4r' .",
                ContentType.parse("text/turtle; charset=ISO-8859-1")));
            Checks.yes(read(graph).contains("b\u00e4r"), read(graph));
        });
        checks.check("Turtle without a charset", () -> {
            String graph = fresh();
            put(201, graph, new StringEntity("<urn:s> <urn:p> 'bear' .", ContentType.parse("text/turtle")));
            Checks.yes(read(graph).contains("bear"), read(graph));
        });
        checks.check("Turtle in UTF-8", () -> {
            String graph = fresh();
            put(201, graph, new StringEntity("<urn:s> <urn:p> 'b\u00e4r\u6f22' .",
                ContentType.parse("text/turtle; charset=UTF-8")));
            Checks.yes(read(graph).contains("b\u00e4r\u6f22"), read(graph));
        });
        checks.check("Turtle in UTF-16", () -> {
            String graph = fresh();
            put(201, graph, new StringEntity("<urn:s> <urn:p> 'b\u00e4r\u6f22' .",
                ContentType.parse("text/turtle; charset=UTF-16")));
            Checks.yes(read(graph).contains("b\u00e4r\u6f22"), read(graph));
        });
        checks.check("RDF/XML in ISO-8859-1", () -> {
            String graph = fresh();
            put(201, graph, new StringEntity("<?xml version='1.0' encoding='ISO-8859-1'?><rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#' "
                + "xmlns:u='urn:'><rdf:Description rdf:about='urn:s'><u:p>b\u00e4r</u:p></rdf:Description></rdf:RDF>",
                ContentType.parse("application/rdf+xml; charset=ISO-8859-1")));
            Checks.yes(read(graph).contains("b\u00e4r"), read(graph));
        });
        checks.check("a plain string is a file of text", () -> {
            String file = fresh() + ".txt";
            put(201, file, new StringEntity("b\u00e4r"));
            Checks.equal("b\u00e4r", expect(200, ClassicRequestBuilder.get(file).build()).body);
        });
        checks.check("an update in ISO-8859-1", () -> {
            String graph = fresh();
            expect(204, ClassicRequestBuilder.post(url + "sparql").setEntity(new StringEntity(
                "INSERT DATA { GRAPH <" + graph + "> { <urn:s> <urn:p> 'b\u00e4r' } }",
                    ContentType.parse("application/sparql-update; charset=ISO-8859-1"))).build());
            Checks.yes(read(graph).contains("b\u00e4r"), read(graph));
        });
        checks.check("JSON for a service in its default charset", () -> expect(201, ClassicRequestBuilder.post(url
            + "services/aircraft/get_power")
            .setEntity(new StringEntity("{}", ContentType.APPLICATION_JSON)).build()));
    }

    private void forms(Checks checks) {
        checks.check("a query as a form, as it is encoded by default", () -> {
            Answer answer = expect(200, ClassicRequestBuilder.post(url + "sparql").setHeader("Accept",
                "text/csv").setEntity(
                new UrlEncodedFormEntity(List.of(new BasicNameValuePair("query",
                    "SELECT ('b\u00e4r+&' AS ?x) {}")))).build());
            Checks.yes(answer.body.contains("b\u00e4r+&"), answer);
        });
        checks.check("an update as a form, as it is encoded by default", () -> {
            String graph = fresh();
            expect(204, ClassicRequestBuilder.post(url + "sparql").setEntity(new UrlEncodedFormEntity(List.of(
                new BasicNameValuePair("update", "INSERT DATA { GRAPH <" + graph
                    + "> { <urn:s> <urn:p> 'b\u00e4r' } }")))).build());
            Checks.yes(read(graph).contains("b\u00e4r"), read(graph));
        });
        checks.check("graphs as multipart/form-data", () -> {
            String graph = fresh();
            for (String value : new String[] {"one", "two"}) {
                HttpEntity parts = MultipartEntityBuilder.create()
                    .addBinaryBody("graph", ("<urn:s> <urn:p> '" + value + "' .").getBytes(),
                        ContentType.parse("text/turtle"), "g.ttl").build();
                Answer answer = send(ClassicRequestBuilder.post(url + "graphs").addParameter("graph",
                    graph).setEntity(parts).build());
                Checks.yes(answer.status < 300, answer);
            }
            Checks.yes(read(graph).contains("one") && read(graph).contains("two"), read(graph));
        });
    }

    private void rest(Checks checks) {
        checks.check("GET that offers an upgrade to TLS", () -> {
            Checks.yes(read(url + "topics/").contains("topics/"), "nothing");
            expect(200, ClassicRequestBuilder.head(url).build());
            Checks.yes(expect(204, ClassicRequestBuilder.options(url).build()).body.isEmpty(), "a body");
        });
        checks.check("a body in chunks", () -> {
            String graph = fresh();
            byte[] body = "<urn:s> <urn:p> 'chunk' .\n".repeat(3000).getBytes();
            put(201, graph, new InputStreamEntity(new java.io.ByteArrayInputStream(body),
                ContentType.parse("text/turtle")));
            Checks.yes(read(graph).contains("chunk"), "lost");
        });
        checks.check("one connection for read, write, read", () -> {
            String graph = fresh();
            try (CloseableHttpClient client = HttpClients.createDefault()) {
                Checks.equal(200, send(client, ClassicRequestBuilder.get(url).build()).status);
                StringEntity turtle = new StringEntity("<urn:s> <urn:p> 1 .", ContentType.parse("text/turtle"));
                Checks.equal(201, send(client, ClassicRequestBuilder.put(graph).setEntity(turtle).build()).status);
                Checks.equal(200, send(client, ClassicRequestBuilder.get(graph).build()).status);
                Checks.equal(204, send(client, ClassicRequestBuilder.delete(graph).build()).status);
            }
        });
        checks.check("POST to a container with a Slug", () -> {
            ClassicHttpRequest request = ClassicRequestBuilder.post(url + "data/").setHeader("Slug", "apache-posted")
                .setEntity(new StringEntity("<> <urn:p> 'posted' .", ContentType.parse("text/turtle"))).build();
            Checks.yes(read(expect(201, request).location).contains("posted"), "lost");
        });
        checks.check("redirects are followed", () -> Checks.yes(read(url + "topics").contains("topics/"),
            "not followed"));
        checks.check("conditional writes", () -> {
            String graph = fresh();
            StringEntity turtle = new StringEntity("<urn:s> <urn:p> 1 .", ContentType.parse("text/turtle"));
            String tag = put(201, graph, turtle).tag;
            expect(204, ClassicRequestBuilder.put(graph).setHeader("If-Match", tag)
                .setEntity(new StringEntity("<urn:s> <urn:p> 2 .", ContentType.parse("text/turtle"))).build());
            expect(412, ClassicRequestBuilder.put(graph).setHeader("If-Match", tag).setEntity(turtle).build());
        });
        checks.check("the asynchronous client writes side by side", () -> {
            String base = fresh();
            try (CloseableHttpAsyncClient client = HttpAsyncClients.createDefault()) {
                client.start();
                List<Future<SimpleHttpResponse>> sent = new ArrayList<>();
                for (int i = 0; i < 20; i++) {
                    SimpleHttpRequest request = SimpleRequestBuilder.put(base + "x" + i)
                        .setBody("<urn:s> <urn:p> " + i + " .",
                            ContentType.parse("text/turtle; charset=UTF-8")).build();
                    sent.add(client.execute(request, null));
                }
                for (Future<SimpleHttpResponse> one : sent) Checks.equal(201, one.get(15, TimeUnit.SECONDS).getCode());
            }
            for (int i = 0; i < 20; i++) read(base + "x" + i);
        });
    }
}
