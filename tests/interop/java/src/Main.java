/** The clients in Java, one after the other in one process: `java Main URL`, the entry URL of a rosld server. */
public final class Main {
    public static void main(String[] arguments) throws Exception {
        String url = arguments[0];
        JdkHttpClient.run(url);
        ApacheHttpClient.run(url);
        JenaQuery.run(url);
        JenaUpdate.run(url);
        JenaGraphStore.run(url);
        JenaLink.run(url);
        Rdf4jRepository.run(url);
        Rdf4jConnection.run(url);
        Rdf4jFederation.run(url);
        Rdf4jRio.run(url);
        Calls.run();
        System.exit(0);
    }
}
