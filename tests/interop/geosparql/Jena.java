import java.io.BufferedReader;
import java.io.InputStreamReader;

import org.apache.jena.geosparql.configuration.GeoSPARQLConfig;
import org.apache.jena.query.QueryExecutionFactory;
import org.apache.jena.query.QuerySolution;
import org.apache.jena.rdf.model.ModelFactory;

/** Evaluates the expressions on stdin by Jena's GeoSPARQL, and prints the lexical form of each result, or an empty line. */
public class Jena {
    public static void main(String[] arguments) throws Exception {
        GeoSPARQLConfig.setupNoIndex();
        var lines = new BufferedReader(new InputStreamReader(System.in));
        for (String line = lines.readLine(); line != null; line = lines.readLine()) {
            try (var execution = QueryExecutionFactory.create("SELECT (" + line + " AS ?x) {}", ModelFactory.createDefaultModel())) {
                QuerySolution row = execution.execSelect().next();
                System.out.println(row.contains("x") ? row.getLiteral("x").getLexicalForm() : "");
            }
        }
    }
}
