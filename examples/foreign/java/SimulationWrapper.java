import java.io.DataInputStream;
import java.io.EOFException;
import java.io.FileDescriptor;
import java.io.FileOutputStream;
import java.io.IOException;
import java.io.OutputStream;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.util.ArrayList;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;

/**
 * Wrapper for zswarm simulators in Java: the protocol of zswarm's docs/foreign.md on standard input and output.
 *
 * Extend it and call {@link #serve} from main. zswarm decides for the agents: a turn names the agents that act next and their
 * observations, and {@link #step} receives their actions. Output goes to standard error. An exception makes the trial's fitness NaN.
 */
abstract class SimulationWrapper {
    private static final int VERSION = 1;
    private static final int LONGEST = 8 << 20; // bytes of a message

    /** The agents that act next, and their observations. */
    record Turn(int[] agents, float[][] observations) {}

    /** The outcome of a trial: a fitness per participant, higher is better, and all metrics. */
    record Outcome(double[] fitness, double[] metrics) {}

    /** The properties of a simulator with its settings; {@code owners}: for each agent the participant that drives it. */
    record World(int inputs, int outputs, int[] owners, int participants, Long firstSeed) {
        /** One genome drives all agents. */
        World(int inputs, int outputs, int agents, Long firstSeed) {
            this(inputs, outputs, new int[agents], 1, firstSeed);
        }
    }

    private final List<Object> settings = new ArrayList<>();
    private OutputStream out;
    private int outputs;
    private int acting; // agents of the last turn

    /** Return the reference; its first line is a summary. */
    protected abstract String description();

    protected abstract List<String> metrics();

    protected abstract List<String> sensors();

    protected abstract List<String> actuators();

    /** Set the values of the settings; throw IllegalArgumentException to refuse them. */
    protected abstract World setup(Map<String, Object> settings) throws Exception;

    /** Begin a trial; the same seed gives the same trial. */
    protected abstract Turn reset(long seed);

    /** Apply the actions of the last turn's agents; return null when the trial is over. */
    protected abstract Turn step(float[][] actions);

    /** Return the outcome of the trial that ended. */
    protected abstract Outcome outcome();

    /** Declare an integer setting; call it in main, before serve. */
    protected void setting(String name, long value, long minimum, long maximum, String meaning) {
        settings.add(message("name", name, "type", "int", "default", value, "minimum", minimum, "maximum", maximum,
                "description", meaning));
    }

    /** Declare a floating-point setting. */
    protected void setting(String name, double value, double minimum, double maximum, String meaning) {
        settings.add(message("name", name, "type", "float", "default", value, "minimum", minimum, "maximum", maximum,
                "description", meaning));
    }

    /** Declare a setting with a list of allowed texts. */
    protected void setting(String name, String value, List<String> choices, String meaning) {
        settings.add(message("name", name, "type", "text", "default", value, "choices", choices, "description", meaning));
    }

    /** Serve until the input ends. */
    public final void serve() throws IOException {
        out = new FileOutputStream(FileDescriptor.out);
        System.setOut(System.err); // output must not corrupt the messages
        DataInputStream in = new DataInputStream(System.in);
        say(message("type", "hello", "v", VERSION, "description", description(), "settings", settings));
        while (true) {
            int length;
            try {
                length = Integer.reverseBytes(in.readInt());
            } catch (EOFException end) {
                return;
            }
            if (length < 0 || length > LONGEST) throw new IOException("a message is too long");
            Map<String, Object> said = map(Msgpack.unpack(in.readNBytes(length)));
            try {
                say(answer(said));
            } catch (IOException end) {
                throw end;
            } catch (Exception error) {
                say(message("type", "error", "text", String.valueOf(error.getMessage() == null ? error : error.getMessage())));
            }
        }
    }

    private Map<String, Object> answer(Map<String, Object> said) throws Exception {
        switch ((String) said.get("type")) {
            case "setup": return ready(setup(map(said.get("settings"))));
            case "reset": return turn(reset((Long) said.get("seed")));
            case "actions": return turn(step(actions((byte[]) said.get("actions"))));
            default: throw new IllegalArgumentException("no message that it knows: " + said.get("type"));
        }
    }

    private Map<String, Object> ready(World world) {
        outputs = world.outputs;
        return message("type", "ready", "inputs", world.inputs, "outputs", world.outputs, "owners", list(world.owners),
                "participants", world.participants, "metrics", metrics(), "sensors", sensors(), "actuators", actuators(),
                "first_seed", world.firstSeed);
    }

    private Map<String, Object> turn(Turn turn) {
        if (turn == null) {
            acting = 0;
            Outcome outcome = outcome();
            return message("type", "end", "fitness", list(outcome.fitness), "metrics", list(outcome.metrics));
        }
        acting = turn.agents.length;
        int numbers = 0;
        for (float[] row : turn.observations) numbers += row.length;
        ByteBuffer observations = ByteBuffer.allocate(4 * numbers).order(ByteOrder.LITTLE_ENDIAN);
        for (float[] row : turn.observations) for (float number : row) observations.putFloat(number);
        return message("type", "turn", "agents", list(turn.agents), "observations", observations.array());
    }

    private float[][] actions(byte[] bytes) {
        if (acting == 0 || bytes.length != 4 * acting * outputs) throw new IllegalArgumentException("actions: not of the last turn");
        ByteBuffer numbers = ByteBuffer.wrap(bytes).order(ByteOrder.LITTLE_ENDIAN);
        float[][] actions = new float[acting][outputs];
        for (float[] row : actions) for (int i = 0; i < outputs; i++) row[i] = numbers.getFloat();
        return actions;
    }

    private void say(Map<String, Object> message) throws IOException {
        byte[] body = Msgpack.pack(message);
        ByteBuffer frame = ByteBuffer.allocate(4 + body.length).order(ByteOrder.LITTLE_ENDIAN);
        out.write(frame.putInt(body.length).put(body).array()); // in one write
    }

    private static Map<String, Object> message(Object... keysAndValues) {
        Map<String, Object> message = new LinkedHashMap<>();
        for (int i = 0; i < keysAndValues.length; i += 2) message.put((String) keysAndValues[i], keysAndValues[i + 1]);
        return message;
    }

    @SuppressWarnings("unchecked")
    private static Map<String, Object> map(Object value) {
        return (Map<String, Object>) value;
    }

    private static List<Object> list(int[] numbers) {
        List<Object> list = new ArrayList<>();
        for (int number : numbers) list.add(number);
        return list;
    }

    private static List<Object> list(double[] numbers) {
        List<Object> list = new ArrayList<>();
        for (double number : numbers) list.add(number);
        return list;
    }
}
