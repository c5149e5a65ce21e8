import java.io.BufferedReader;
import java.io.IOException;
import java.io.InputStreamReader;
import java.io.PrintStream;
import java.nio.charset.StandardCharsets;
import org.obolibrary.robot.CommandLineInterface;

/** Carries out commands of ROBOT in one JVM: one a line, of words between tabs; for each prints what went wrong. */
public final class Robot {
    public static void main(String[] arguments) throws IOException {
        PrintStream outcomes = System.out;
        System.setOut(System.err);
        var commands = new BufferedReader(new InputStreamReader(System.in, StandardCharsets.UTF_8));
        for (String command = commands.readLine(); command != null; command = commands.readLine()) {
            String outcome = "";
            try {
                CommandLineInterface.execute(command.split("\t"));
            } catch (Exception error) {
                outcome = error.toString();
            }
            outcomes.println(outcome.replace('\n', ' '));
            outcomes.flush();
        }
    }
}
