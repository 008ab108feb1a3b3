"""The paper's designs and ours, measured side by side: ``make paper``."""
