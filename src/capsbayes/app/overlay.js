// A picture with the lines that were found in it. Walls are dragged with the mouse, a finger or the arrow keys.
export default {
  template: `
    <div><svg ref="svg" class="bench-overlay" :class="{ dragging: held !== null }" :viewBox="[-0.5, -0.5, columns, rows].join(' ')" role="group"
         aria-label="Picture of the capsule with what was found in it" @pointerdown="begin" @pointermove="move"
         @pointerup="end" @pointercancel="end">
      <image :href="src" x="-0.5" y="-0.5" :width="columns" :height="rows" preserveAspectRatio="none"/>
      <rect v-for="([name, box], k) in boxes" :key="k" :class="name" :x="box[0] - 0.5" :y="box[1] - 0.5" :width="box[2]"
            :height="box[3]"/>
      <polygon v-if="predicted" class="predicted" :points="points(predicted)"/>
      <polygon v-if="outline" class="edge" :points="points(outline)"/>
      <polyline v-if="rear" class="rear" :points="points(rear)"/>
      <template v-if="placed">
        <g v-for="(name, k) in ['Upper wall', 'Lower wall']" :key="name">
          <line class="wall" :class="{ stated: byHand }" x1="-0.5" :x2="columns - 0.5"
                :y1="placed[2 * k]" :y2="placed[2 * k + 1]"/>
          <line class="handle" x1="-0.5" :x2="columns - 0.5" :y1="placed[2 * k]" :y2="placed[2 * k + 1]" tabindex="0"
                role="slider" :aria-label="name + ', row in pixels; arrow keys move it'" :data-wall="k"
                aria-orientation="vertical" aria-valuemin="0" :aria-valuemax="rows - 1"
                :aria-valuenow="middle(k).toFixed(1)" @keydown="key($event, k)"/>
        </g>
      </template>
    </svg>
    <p v-if="placed" class="bench-told">{{ apart }}</p></div>`,
  props: {
    src: String, columns: Number, rows: Number, byHand: Boolean, drawing: Boolean,
    walls: Array, outline: Array, rear: Array, predicted: Array, crop: Array, erased: Array,
    width: Number, // of the channel in micrometres, 0 where it is not known
    pixel: Number, // micrometres as the file states them, 0 where it does not
  },
  data() {
    return { placed: this.walls, box: null, held: null, start: null, timer: null };
  },
  watch: {
    walls(now) { if (this.held === null && this.timer === null) this.placed = now; },
    crop() { this.box = null; },
    erased() { this.box = null; },
  },
  computed: {
    apart() { // across the walls, as the half width is
      const [a, b, c, d] = this.placed, slope = (b - a + d - c) / (2 * (this.columns - 1));
      const px = (c + d - a - b) / (2 * Math.hypot(1, slope));
      const scale = this.width && px > 0 ? ` = ${+this.width.toPrecision(4)} µm: a pixel is ${(this.width / px).toPrecision(3)} µm` : "";
      const stated = this.pixel ? `, ${+(px * this.pixel).toPrecision(4)} µm by the size of a pixel in the file` : "";
      const apart = scale && stated && Math.abs(Math.log(px * this.pixel / this.width)) > 0.03; // beyond the errors of a scale
      return `Walls ${px.toFixed(1)} px apart${scale}${stated}.${apart ? " Check the half width: one of the two is wrong." : ""}`;
    },
    boxes() {
      const stated = [...(this.crop ? [["crop", this.crop]] : []), ...(this.erased || []).map((box) => ["erased", box])];
      return this.box ? [...stated, ["drawn", this.box]] : stated;
    },
  },
  methods: {
    points(list) { return list.map((point) => point.join(",")).join(" "); },
    middle(k) { return 0.5 * (this.placed[2 * k] + this.placed[2 * k + 1]); },
    place(event) {
      const svg = this.$refs.svg;
      const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      return [Math.min(Math.max(at.x, 0), this.columns - 1), Math.min(Math.max(at.y, 0), this.rows - 1)];
    },
    begin(event) {
      const wall = event.target.dataset.wall;
      if (wall === undefined && !this.drawing) return;
      this.$refs.svg.setPointerCapture(event.pointerId);
      this.start = this.place(event);
      this.held = wall === undefined || this.drawing ? "box" : Number(wall);
    },
    move(event) {
      if (this.held === null) return;
      const [x, y] = this.place(event);
      if (this.held === "box") {
        const [x0, y0] = this.start;
        const left = Math.round(Math.min(x, x0)), top = Math.round(Math.min(y, y0));
        this.box = [left, top, Math.round(Math.abs(x - x0)) + 1, Math.round(Math.abs(y - y0)) + 1];
      } else {
        this.shift(this.held, y - this.start[1]);
        this.start = [x, y];
      }
    },
    end() {
      if (this.held === "box" && this.box) this.$emit("box", this.box);
      else if (this.held !== null) this.$emit("walls", this.placed);
      this.held = null;
    },
    shift(k, by) {
      this.placed = this.placed.map((row, end) => (end >> 1 === k ? row + by : row));
    },
    key(event, k) {
      const sense = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (!sense) return;
      event.preventDefault();
      this.shift(k, sense * (event.shiftKey ? 5 : 0.5));
      clearTimeout(this.timer);
      this.timer = setTimeout(() => { this.timer = null; this.$emit("walls", this.placed); }, 300);
    },
  },
};
