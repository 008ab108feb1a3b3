import java.io.ByteArrayOutputStream;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;

/** The part of msgpack (msgpack.org) that messages need. Integers are Long; from 2^63 on the negative Long of the same bits. */
final class Msgpack {
    private final ByteBuffer in;

    private Msgpack(byte[] message) {
        in = ByteBuffer.wrap(message);
    }

    /** Read a Map, List, String, byte[], Long, Double, Boolean or null. */
    static Object unpack(byte[] message) {
        return new Msgpack(message).value();
    }

    static byte[] pack(Object value) {
        ByteArrayOutputStream out = new ByteArrayOutputStream();
        put(out, value);
        return out.toByteArray();
    }

    private Object value() {
        int code = in.get() & 0xff;
        if (code < 0x80 || code >= 0xe0) return (long) (byte) code;
        if (code < 0x90) return map(code & 15);
        if (code < 0xa0) return list(code & 15);
        if (code < 0xc0) return text(code & 31);
        switch (code) {
            case 0xc0: return null;
            case 0xc2: return false;
            case 0xc3: return true;
            case 0xc4: return bytes(in.get() & 0xff);
            case 0xc5: return bytes(in.getShort() & 0xffff);
            case 0xc6: return bytes(in.getInt());
            case 0xca: return (double) in.getFloat();
            case 0xcb: return in.getDouble();
            case 0xcc: return (long) (in.get() & 0xff);
            case 0xcd: return (long) (in.getShort() & 0xffff);
            case 0xce: return in.getInt() & 0xffffffffL;
            case 0xcf: case 0xd3: return in.getLong();
            case 0xd0: return (long) in.get();
            case 0xd1: return (long) in.getShort();
            case 0xd2: return (long) in.getInt();
            case 0xd9: return text(in.get() & 0xff);
            case 0xda: return text(in.getShort() & 0xffff);
            case 0xdb: return text(in.getInt());
            case 0xdc: return list(in.getShort() & 0xffff);
            case 0xdd: return list(in.getInt());
            case 0xde: return map(in.getShort() & 0xffff);
            case 0xdf: return map(in.getInt());
            default: throw new IllegalArgumentException("a message has a value of no known kind");
        }
    }

    private Map<String, Object> map(int fields) {
        Map<String, Object> map = new LinkedHashMap<>();
        for (int i = 0; i < fields; i++) {
            String key = (String) value();
            map.put(key, value());
        }
        return map;
    }

    private List<Object> list(int items) {
        List<Object> list = new ArrayList<>();
        for (int i = 0; i < items; i++) list.add(value());
        return list;
    }

    private String text(int length) {
        return new String(bytes(length), StandardCharsets.UTF_8);
    }

    private byte[] bytes(int length) {
        byte[] bytes = new byte[length];
        in.get(bytes);
        return bytes;
    }

    private static void put(ByteArrayOutputStream out, Object value) {
        if (value == null) {
            out.write(0xc0);
        } else if (value instanceof Boolean) {
            out.write((Boolean) value ? 0xc3 : 0xc2);
        } else if (value instanceof Integer || value instanceof Long) {
            out.write(0xd3);
            out.writeBytes(ByteBuffer.allocate(8).putLong(((Number) value).longValue()).array());
        } else if (value instanceof Number) {
            out.write(0xcb);
            out.writeBytes(ByteBuffer.allocate(8).putDouble(((Number) value).doubleValue()).array());
        } else if (value instanceof String) {
            byte[] text = ((String) value).getBytes(StandardCharsets.UTF_8);
            head(out, 0xdb, text.length);
            out.writeBytes(text);
        } else if (value instanceof byte[]) {
            head(out, 0xc6, ((byte[]) value).length);
            out.writeBytes((byte[]) value);
        } else if (value instanceof List) {
            head(out, 0xdd, ((List<?>) value).size());
            for (Object item : (List<?>) value) put(out, item);
        } else if (value instanceof Map) {
            head(out, 0xdf, ((Map<?, ?>) value).size());
            ((Map<?, ?>) value).forEach((key, item) -> {
                put(out, key);
                put(out, item);
            });
        } else {
            throw new IllegalArgumentException("msgpack has no " + value.getClass());
        }
    }

    private static void head(ByteArrayOutputStream out, int code, int length) {
        out.write(code);
        out.writeBytes(ByteBuffer.allocate(4).putInt(length).array());
    }
}
