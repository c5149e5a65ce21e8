import java.lang.reflect.InvocationTargetException;
import java.lang.reflect.Method;
import java.lang.reflect.Modifier;
import java.lang.reflect.Proxy;
import java.util.Arrays;
import java.util.List;
import java.util.Map;
import java.util.Set;
import java.util.TreeSet;
import java.util.concurrent.ConcurrentHashMap;
import java.util.stream.Collectors;
import org.apache.jena.rdfconnection.RDFConnection;
import org.apache.jena.rdflink.RDFLink;
import org.apache.jena.sparql.core.Transactional;
import org.eclipse.rdf4j.repository.RepositoryConnection;

/** Connections that note which calls of their interface were made, and which of these were answered. */
final class Calls {
    private static final Map<Class<?>, Set<String>> MADE = new ConcurrentHashMap<>();
    private static final Map<Class<?>, Set<String>> ANSWERED = new ConcurrentHashMap<>();

    private Calls() {}

    /** To be run when all others have been. */
    static void run() {
        Checks checks = new Checks("Calls");
        checks.check("every call of RDFConnection is answered", () -> complete(RDFConnection.class));
        checks.check("every call of RDFLink is answered", () -> complete(RDFLink.class));
        checks.check("every call of RepositoryConnection is answered but one that RDF4J does not send", () ->
            complete(RepositoryConnection.class, "prepare()"));
    }

    /** The same connection, with its calls noted. */
    static <T> T noted(Class<T> type, T connection) {
        return type.cast(Proxy.newProxyInstance(type.getClassLoader(), new Class<?>[] {type},
            (proxy, method, arguments) -> {
                add(MADE, type, method);
                try {
                    Object result = method.invoke(connection, arguments);
                    add(ANSWERED, type, method);
                    return result;
                } catch (InvocationTargetException error) {
                    throw error.getCause();
                }
            }));
    }

    /** Every call of an interface has been made, and all but these, which are refused, have been answered. */
    static void complete(Class<?> type, String... refused) {
        Set<String> calls = Arrays.stream(type.getMethods()).filter(Calls::isSent)
            .map(Calls::signature).collect(Collectors.toCollection(TreeSet::new));
        Checks.yes(calls.size() > 30, calls);
        Checks.equal(List.of(), without(calls, MADE.get(type)));
        Checks.equal(List.of(refused), without(calls, ANSWERED.get(type)));
    }

    private static void add(Map<Class<?>, Set<String>> noted, Class<?> type, Method method) {
        noted.computeIfAbsent(type, each -> ConcurrentHashMap.newKeySet()).add(signature(method));
    }

    private static List<String> without(Set<String> calls, Set<String> others) {
        return calls.stream().filter(each -> !others.contains(each)).toList();
    }

    /** Jena's transactions send nothing. */
    private static boolean isSent(Method method) {
        return !Modifier.isStatic(method.getModifiers()) && method.getDeclaringClass() != Transactional.class;
    }

    private static String signature(Method method) {
        return method.getName() + Arrays.stream(method.getParameterTypes()).map(Class::getSimpleName)
            .collect(Collectors.joining(", ", "(", ")"));
    }
}
