import java.io.ByteArrayInputStream;
import java.net.URI;
import java.net.http.HttpClient;
import java.net.http.HttpRequest;
import java.net.http.HttpRequest.BodyPublishers;
import java.net.http.HttpResponse;
import java.net.http.HttpResponse.BodyHandlers;
import java.net.http.WebSocket;
import java.nio.charset.StandardCharsets;
import java.util.List;
import java.util.concurrent.CompletableFuture;
import java.util.concurrent.CompletionStage;
import java.util.concurrent.TimeUnit;
import java.util.stream.IntStream;
import java.util.stream.Stream;

/** The JDK's HttpClient, which asks for an upgrade to h2c with each new connection. */
final class JdkHttpClient {
    private final String url;
    private final String folder;
    private final HttpClient client = HttpClient.newHttpClient();
    private int counter;

    private JdkHttpClient(String url) {
        this.url = url;
        folder = url + "data/jdk/";
    }

    static void run(String url) {
        new JdkHttpClient(url).run(new Checks("JdkHttpClient"));
    }

    private String fresh() {
        return folder + "r" + ++counter;
    }

    private static HttpRequest.Builder to(String url) {
        return HttpRequest.newBuilder(URI.create(url));
    }

    private static HttpRequest put(String url, String turtle) {
        return to(url).header("Content-Type", "text/turtle").PUT(BodyPublishers.ofString(turtle)).build();
    }

    private HttpResponse<String> send(HttpRequest request) throws Exception {
        return client.send(request, BodyHandlers.ofString());
    }

    private void expect(int status, HttpRequest request) throws Exception {
        HttpResponse<String> answer = send(request);
        Checks.yes(answer.statusCode() == status, answer.statusCode() + ": " + answer.body());
    }

    private String turtle(String url) throws Exception {
        HttpResponse<String> answer = send(to(url).header("Accept", "application/n-triples").build());
        Checks.equal(200, answer.statusCode());
        return answer.body();
    }

    private void run(Checks checks) {
        bodies(checks);
        conditions(checks);
        connections(checks);
        streams(checks);
    }

    private void bodies(Checks checks) {
        checks.check("PUT with a length", () -> {
            String graph = fresh();
            expect(201, put(graph, "<urn:s> <urn:p> 'first' ."));
            Checks.yes(turtle(graph).contains("first"), "the body was lost");
        });
        checks.check("PUT in chunks", () -> {
            String graph = fresh();
            byte[] body = "<urn:s> <urn:p> 'chunk' .\n".repeat(3000).getBytes(StandardCharsets.UTF_8);
            expect(201, to(graph).header("Content-Type", "text/turtle").PUT(BodyPublishers.ofInputStream(() ->
                new ByteArrayInputStream(body))).build());
            Checks.yes(turtle(graph).contains("chunk"), "the body was lost");
        });
        checks.check("PUT in chunks by a new client", () -> {
            String graph = fresh();
            byte[] body = "<urn:s> <urn:p> 'chunk' .".getBytes(StandardCharsets.UTF_8);
            HttpRequest request = to(graph).header("Content-Type", "text/turtle").PUT(BodyPublishers.ofInputStream(() ->
                new ByteArrayInputStream(body))).build();
            Checks.equal(201, HttpClient.newHttpClient().send(request, BodyHandlers.ofString()).statusCode());
            Checks.yes(turtle(graph).contains("chunk"), "the body was lost");
        });
        checks.check("PUT of a file of 3 MB, and a range of it", () -> {
            String file = fresh() + ".bin";
            byte[] body = new byte[3_000_000];
            for (int i = 0; i < body.length; i++) body[i] = (byte) i;
            expect(201, to(file).header("Content-Type",
                "application/octet-stream").PUT(BodyPublishers.ofByteArray(body)).build());
            HttpResponse<byte[]> whole = client.send(to(file).build(), BodyHandlers.ofByteArray());
            Checks.yes(java.util.Arrays.equals(body, whole.body()), "other bytes");
            HttpResponse<byte[]> part = client.send(to(file).header("Range", "bytes=256-259").build(),
                BodyHandlers.ofByteArray());
            Checks.equal(206, part.statusCode());
            Checks.yes(java.util.Arrays.equals(new byte[] {0, 1, 2, 3}, part.body()), "another part");
        });
        checks.check("POST to a container, by a new client", () -> {
            HttpRequest request = to(url + "data/").header("Content-Type", "text/turtle").header("Slug", "posted")
                .POST(BodyPublishers.ofString("<> <urn:p> 'posted' .")).build();
            HttpResponse<String> answer = HttpClient.newHttpClient().send(request, BodyHandlers.ofString());
            Checks.equal(201, answer.statusCode());
            Checks.yes(turtle(answer.headers().firstValue("Location").orElseThrow()).contains("posted"),
                "the body was lost");
        });
        checks.check("a service is called, by a new client", () -> {
            HttpRequest request = to(url + "services/aircraft/engine/set_direction").header("Content-Type",
                "application/json")
                .header("Accept", "application/json").POST(BodyPublishers.ofString("{\"data\": 0}")).build();
            HttpResponse<String> answer = HttpClient.newHttpClient().send(request, BodyHandlers.ofString());
            Checks.yes(answer.statusCode() == 201 || answer.statusCode() == 422, answer.statusCode() + ": "
                + answer.body());
        });
        checks.check("PATCH", () -> {
            String graph = fresh();
            expect(201, put(graph, "<urn:s> <urn:p> 'one' ."));
            expect(204, to(graph).header("Content-Type", "application/sparql-update")
                .method("PATCH", BodyPublishers.ofString("INSERT DATA { <urn:s> <urn:p> 'two' }")).build());
            Checks.yes(turtle(graph).contains("two"), "not patched");
        });
        checks.check("PUT that waits for 100 Continue", () -> {
            String graph = fresh();
            expect(201, to(graph).expectContinue(true).header("Content-Type", "text/turtle")
                .PUT(BodyPublishers.ofString("<urn:s> <urn:p> 'continued' .")).build());
            Checks.yes(turtle(graph).contains("continued"), "the body was lost");
        });
        checks.check("DELETE", () -> {
            String graph = fresh();
            expect(201, put(graph, ""));
            expect(204, to(graph).DELETE().build());
            Checks.yes(send(to(graph).build()).statusCode() >= 404, "still there");
        });
        checks.check("a topic is published", () -> expect(204, to(url + "topics/cockpit/display").header("Content-Type",
            "application/json")
            .PUT(BodyPublishers.ofString("{\"data\": \"java\"}")).build()));
    }

    private void conditions(Checks checks) {
        checks.check("HEAD has no body", () -> {
            HttpResponse<String> answer = send(to(url).method("HEAD", BodyPublishers.noBody()).build());
            Checks.equal(200, answer.statusCode());
            Checks.equal("", answer.body());
        });
        checks.check("If-None-Match is 304", () -> {
            HttpResponse<String> answer = send(to(url + "ontology").build());
            expect(304, to(url + "ontology").header("If-None-Match",
                answer.headers().firstValue("ETag").orElseThrow()).build());
        });
        checks.check("If-Match of an older state is 412", () -> {
            String graph = fresh();
            String tag = send(put(graph, "<urn:s> <urn:p> 1 .")).headers().firstValue("ETag").orElseThrow();
            expect(204, put(graph, "<urn:s> <urn:p> 2 ."));
            expect(412, to(graph).header("Content-Type", "text/turtle").header("If-Match",
                tag).PUT(BodyPublishers.ofString("")).build());
        });
        checks.check("redirects are followed where asked", () -> {
            HttpClient following = HttpClient.newBuilder().followRedirects(HttpClient.Redirect.NORMAL).build();
            Checks.equal(200, following.send(to(url + "topics").build(), BodyHandlers.ofString()).statusCode());
        });
    }

    private void connections(Checks checks) {
        checks.check("fifty writes side by side", () -> {
            String base = fresh();
            List<CompletableFuture<HttpResponse<String>>> sent = IntStream.range(0, 50)
                .mapToObj(i -> client.sendAsync(put(base + "x" + i, "<urn:s> <urn:p> " + i + " ."),
                    BodyHandlers.ofString())).toList();
            for (CompletableFuture<HttpResponse<String>> one : sent) Checks.equal(201, one.get(15,
                TimeUnit.SECONDS).statusCode());
            for (int i = 0; i < 50; i++) Checks.yes(turtle(base + "x" + i).contains("\"" + i + "\""), "lost: " + i);
        });
        checks.check("a request after a refused one is carried out", () -> {
            String graph = fresh();
            expect(400, put(graph, "no turtle"));
            expect(201, put(graph, "<urn:s> <urn:p> 1 ."));
        });
    }

    private void streams(Checks checks) {
        checks.check("an event stream is followed", () -> {
            HttpRequest request = to(url + "topics/cockpit/display").header("Accept", "text/event-stream").build();
            HttpResponse<Stream<String>> answer = client.send(request, BodyHandlers.ofLines());
            Checks.equal(200, answer.statusCode());
            try (Stream<String> lines = answer.body()) {
                Checks.yes(lines.anyMatch(line -> line.startsWith("data")), "nothing came");
            }
        });
        checks.check("a WebSocket tells of a change", () -> {
            String wish = "{\"@context\": [\"https://www.w3.org/ns/solid/notification/v1\"], "
                + "\"type\": \"http://www.w3.org/ns/solid/notifications#WebSocketChannel2023\", \"topic\": \"" + url
                    + "data/\"}";
            HttpResponse<String> made = send(to(url + "channels/WebSocketChannel2023").header("Content-Type",
                "application/ld+json")
                .header("Accept", "application/ld+json").POST(BodyPublishers.ofString(wish)).build());
            String from = made.body().replaceAll("(?s).*\"receiveFrom\":\\s*\"([^\"]+)\".*", "$1");
            CompletableFuture<String> told = new CompletableFuture<>();
            WebSocket socket = client.newWebSocketBuilder().buildAsync(URI.create(from), new WebSocket.Listener() {
                private final StringBuilder text = new StringBuilder();

                @Override
                public CompletionStage<?> onText(WebSocket socket, CharSequence data, boolean last) {
                    text.append(data);
                    if (last && text.indexOf("watched") >= 0) told.complete(text.toString());
                    socket.request(1);
                    return null;
                }
            }).get(10, TimeUnit.SECONDS);
            expect(201, put(url + "data/watched" + System.nanoTime(), "<urn:s> <urn:p> 1 ."));
            told.get(10, TimeUnit.SECONDS);
            socket.abort();
        });
    }
}
