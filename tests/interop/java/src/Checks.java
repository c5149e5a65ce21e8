import java.util.Objects;
import java.util.concurrent.ExecutionException;
import java.util.concurrent.ExecutorService;
import java.util.concurrent.Executors;
import java.util.concurrent.TimeUnit;

/** Runs the checks of one client in turn and prints the outcome of each as a line of JSON. */
final class Checks {
    private static final long LIMIT_S = 60;
    private static final ExecutorService THREADS = Executors.newCachedThreadPool(task -> {
        Thread thread = new Thread(task);
        thread.setDaemon(true);
        return thread;
    });

    private final String client;

    Checks(String client) {
        this.client = client;
    }

    /** Something a client does; it fails by throwing. */
    interface Check {
        void run() throws Exception;
    }

    void check(String name, Check check) {
        String error = outcome(check);
        System.out.printf("{\"client\": %s, \"check\": %s, \"error\": %s}%n", json(client), json(name), json(error));
    }

    static void equal(Object expected, Object found) {
        if (!Objects.equals(expected, found)) throw new AssertionError("expected " + expected + ", found " + found);
    }

    static void yes(boolean true_, Object otherwise) {
        if (!true_) throw new AssertionError(otherwise);
    }

    /** Expects an error of this class whose text has this part. */
    static void fails(Class<? extends Throwable> kind, String part, Check check) throws Exception {
        try {
            check.run();
        } catch (Throwable error) {
            yes(kind.isInstance(error), "expected " + kind.getName() + ", not " + error);
            yes(String.valueOf(error).contains(part), "expected '" + part + "' in " + error);
            return;
        }
        throw new AssertionError("expected " + kind.getName());
    }

    private static String outcome(Check check) {
        try {
            THREADS.submit(() -> {
                check.run();
                return null;
            }).get(LIMIT_S, TimeUnit.SECONDS);
            return null;
        } catch (ExecutionException error) {
            Throwable cause = error.getCause();
            StackTraceElement[] trace = cause.getStackTrace();
            StringBuilder text = new StringBuilder(cause.toString());
            for (Throwable deeper = cause.getCause(); deeper != null;
                deeper = deeper.getCause()) text.append("; ").append(deeper);
            for (int i = 0; i < Math.min(12, trace.length); i++) text.append("\n  at ").append(trace[i]);
            return text.toString();
        } catch (Exception error) {
            return "no end within " + LIMIT_S + " s: " + error;
        }
    }

    private static String json(String text) {
        if (text == null) return "null";
        StringBuilder out = new StringBuilder("\"");
        for (char c : text.toCharArray()) {
            if (c == '"' || c == '\\') out.append('\\').append(c);
            else if (c < 0x20 || c > 0x7e) out.append(String.format("\\u%04x", (int) c));
            else out.append(c);
        }
        return out.append('"').toString();
    }
}
